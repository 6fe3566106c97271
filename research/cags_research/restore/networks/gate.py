"""How much of a restored picture is shown: the error expected of the client's own picture, told from both pictures.

At the base level a client's picture is 25 dB from the truth and an aligned reference 35; at the top of the ladder it
is 50 dB. A network that sees twelve pixels around each has to restore the one and leave the other alone, and left to
itself it does not learn when: it wins 7 dB at the base and loses 6 at the top. What tells the two apart is how the
pictures differ over a region: wrong colours differ in patches, a reference's blur and misregistration around edges.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

CELL_PX = 8
"""Side of the cells over which differences are averaged, client pixels: at least a reference pixel."""

WIDTH = 16
FLOOR = 1e-6
"""Mean square under which differences are nothing: 60 dB."""

_MEASURES = 4
_LOG_MIDDLE, _LOG_SPREAD = -9.0, 3.0
"""Of the logarithms of mean squares between the floor and 1: about 0 in the middle, within two either way."""


class ErrorGate(nn.Module):
    """Share [B, H, W, 1] in (0, 1) of a restored picture, from the aligned reference and the client's own picture.

    Four mean squares a cell (smooth and sharp part of the difference, sharp part of either picture) go through two 3x3
    convolutions of 16 channels and one 1x1: each cell decides from what lies within 28 pixels.
    """

    def __init__(self) -> None:
        super().__init__()
        self.first = nn.Conv2d(_MEASURES, WIDTH, 3, padding=1)
        self.second = nn.Conv2d(WIDTH, WIDTH, 3, padding=2, dilation=2)
        self.last = nn.Conv2d(WIDTH, 1, 1)
        nn.init.zeros_(self.last.weight)  # untrained, it halves everywhere
        assert self.last.bias is not None
        nn.init.zeros_(self.last.bias)

    def forward(self, aligned: Tensor, distorted: Tensor) -> Tensor:
        """Images are [B, H, W, 3] of any size."""
        height, width = aligned.shape[1], aligned.shape[2]
        spare = (0, -width % CELL_PX, 0, -height % CELL_PX)
        a, d = (functional.pad(image.permute(0, 3, 1, 2), spare, mode="replicate") for image in (aligned, distorted))
        features = functional.leaky_relu(self.first(_measures(a, d)), 0.1)
        features = functional.leaky_relu(self.second(features), 0.1)
        shares = torch.sigmoid(self.last(features))
        full = functional.interpolate(shares, scale_factor=CELL_PX, mode="bilinear", align_corners=False)
        return full[:, :, :height, :width].permute(0, 2, 3, 1)


def _measures(aligned: Tensor, distorted: Tensor) -> Tensor:
    """Logarithms [B, 4, H/8, W/8] of what the cells of pictures [B, 3, H, W] hold."""
    difference = aligned - distorted
    smooth = _blurred(difference)
    sharp = (difference - smooth, aligned - _blurred(aligned), distorted - _blurred(distorted))
    squares = torch.cat([(part * part).mean(dim=1, keepdim=True) for part in (smooth, *sharp)], dim=1)
    return (torch.log(functional.avg_pool2d(squares, CELL_PX) + FLOOR) - _LOG_MIDDLE) / _LOG_SPREAD


def _blurred(image: Tensor) -> Tensor:
    """A box of 7x7 over ``image`` [B, C, H, W], its border repeated."""
    return functional.avg_pool2d(functional.pad(image, (3, 3, 3, 3), mode="replicate"), 7, stride=1)
