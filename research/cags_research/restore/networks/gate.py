"""How much of a restored picture is shown: told from both pictures and the PSNR that the client's own should have.

At the base level a client's picture is 25 dB from the truth and an aligned reference 35; at the top of the ladder it
is 50 dB. A network that sees twelve pixels around each has to restore the one and leave the other alone, and left to
itself it does not learn when: it wins 7 dB at the base and loses 6 at the top. A gate that has to guess from the
pictures does not either (+6.4, -1.3, -3.8 and -6.5 dB at 0, 0.3, 0.6 and 1 of the ladder). One that was told the level
as a share of the ladder lost up to 1.8 dB in rooms, whose pictures are 8 dB better than others' at the same share. The
encoder has measured every level of the content, so the client knows the PSNR itself.

Of two pictures with independent errors the best mixture has shares as the other's mean square, so its log-odds are the
difference of their PSNR. The gate learns from the pictures what PSNR the restored one has from place to place, and how
much the difference counts. It does so for what is smooth and for what is sharp of the difference: of a reference's
colours more is right than of its edges. Where two pictures differ by much more than the client's own should be wrong,
the reference is what is wrong: so what is expected is among what the PSNR of the restored one is told from, too.

What the pictures tell is how they differ over a region: wrong colours differ in patches, a reference's blur and
misregistration around edges. The latter can be told from the client's own picture: a blurred and shifted copy of it
differs from it by a mixture of its own sharp parts and slopes. What such a mixture does not explain is error, of the
one picture or of the other.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torch.nn import functional

CELL_PX = 8
"""Side of the cells over which differences are averaged, client pixels: at least a reference pixel."""

WIDTH = 16
FLOOR = 1e-6
"""Mean square under which differences are nothing: 60 dB."""

_MEASURES = 8
_LOG_MIDDLE, _LOG_SPREAD = -9.0, 3.0
"""Of the logarithms of mean squares between the floor and 1: about 0 in the middle, within two either way."""

MIDDLE_DB, SPREAD_DB = 36.0, 12.0
"""Of expected PSNR."""

START_DB = 33.0
"""Untrained: the PSNR of the restored picture."""

RANGE_DB = 15.0
"""By how much it may be told to be better or worse. Without a bound a few steps of training make every share 1, from
where no gradient leads back.
"""

LOG_ODDS_A_DB = math.log(10) / 10

SMOOTH_PX = 7
"""Side of the box that parts what is smooth from what is sharp, client pixels."""


class ErrorGate(nn.Module):
    """What is shown of a restored picture: a share in (0, 1) of its smooth difference from the client's own, another of
    the sharp rest.

    The expected PSNR and seven mean squares a cell (of the aligned reference's difference: its part that the client's
    picture does not explain, its means over 7, 15 and 31 pixels, its sharp part; of either picture: the sharp part) go
    through two 3x3 convolutions of 16 channels and one 1x1, which says the PSNR of the restored picture, within 15 dB
    of 33, and how much a decibel of difference counts, a half to two.
    """

    def __init__(self) -> None:
        super().__init__()
        self.first = nn.Conv2d(_MEASURES, WIDTH, 3, padding=1, padding_mode="replicate")
        self.second = nn.Conv2d(WIDTH, WIDTH, 3, padding=2, dilation=2, padding_mode="replicate")
        self.said = nn.Conv2d(WIDTH, 4, 1)  # PSNR, of the smooth and the sharp; weight of a decibel, of either
        nn.init.zeros_(self.said.weight)  # untrained, the expected PSNR alone decides
        assert self.said.bias is not None
        nn.init.zeros_(self.said.bias)

    def shares(self, aligned: Tensor, distorted: Tensor, expected_db: Tensor) -> Tensor:
        """Shares [B, 2, H, W] of what is smooth and of what is sharp. See :meth:`forward`."""
        height, width = aligned.shape[1], aligned.shape[2]
        spare = (0, -width % CELL_PX, 0, -height % CELL_PX)
        a, d = (functional.pad(image.permute(0, 3, 1, 2), spare, mode="replicate") for image in (aligned, distorted))
        measures = _measures(a, d)
        expected = ((expected_db - MIDDLE_DB) / SPREAD_DB).expand(-1, 1, *measures.shape[2:])
        features = functional.leaky_relu(self.first(torch.cat([measures, expected], dim=1)), 0.1)
        features = functional.leaky_relu(self.second(features), 0.1)
        said = self.said(features)
        better_db = START_DB + RANGE_DB * torch.tanh(said[:, :2]) - expected_db
        cells = torch.sigmoid(LOG_ODDS_A_DB * torch.exp2(torch.tanh(said[:, 2:])) * better_db)
        full = functional.interpolate(cells, scale_factor=CELL_PX, mode="bilinear", align_corners=False)
        return full[:, :, :height, :width]

    def forward(self, aligned: Tensor, distorted: Tensor, restored: Tensor, expected_db: Tensor) -> Tensor:
        """What is shown [B, H, W, 3]. Images are [B, H, W, 3] of any size; ``expected_db`` [B, 1, 1, 1] is the
        PSNR that ``distorted`` should have (``RestoreInput.expected_db``)."""
        difference = (restored - distorted).permute(0, 3, 1, 2)
        smooth = _blurred(difference, SMOOTH_PX)
        shares = self.shares(aligned, distorted, expected_db)
        shown = shares[:, :1] * smooth + shares[:, 1:] * (difference - smooth)
        return distorted + shown.permute(0, 2, 3, 1)


def _measures(aligned: Tensor, distorted: Tensor) -> Tensor:
    """Logarithms [B, 7, H/8, W/8] of what the cells of pictures [B, 3, H, W] hold."""
    difference = aligned - distorted
    smooth, detail = _blurred(difference, 7), distorted - _blurred(distorted, 7)
    means = (smooth, _blurred(difference, 15), _blurred(difference, 31))
    sharp = (difference - smooth, aligned - _blurred(aligned, 7), detail)
    cells = [_over_cells(part * part) for part in (*means, *sharp)]
    ways = (distorted - _blurred(distorted, 3), detail, *_slopes(_blurred(distorted, 3)))
    measured = torch.cat([_unexplained(difference, ways), *cells], dim=1)
    return (torch.log(measured + FLOOR) - _LOG_MIDDLE) / _LOG_SPREAD


def _unexplained(difference: Tensor, ways: Sequence[Tensor]) -> Tensor:
    """Mean square [B, 1, H/8, W/8] of what no mixture of ``ways`` [B, 3, H, W] makes of ``difference``, over 3x3 cells.

    Least squares by elimination in the table of mean products, so that it runs wherever the network does.
    """
    parts = (*ways, difference)
    last = len(parts) - 1
    table = {(i, j): _blurred(_over_cells(parts[i] * parts[j]), 3) for i in range(last + 1) for j in range(i, last + 1)}
    for k in range(last):
        for i in range(k + 1, last + 1):
            share = table[k, i] / (table[k, k] + FLOOR)
            for j in range(i, last + 1):
                table[i, j] = table[i, j] - share * table[k, j]
    return table[last, last].clamp(min=0.0)


def _slopes(image: Tensor) -> tuple[Tensor, Tensor]:
    """Half the difference of each pixel's neighbours, across and down."""
    wide = functional.pad(image, (1, 1, 1, 1), mode="replicate")
    across = wide[:, :, 1:-1, 2:] - wide[:, :, 1:-1, :-2]
    return across / 2, (wide[:, :, 2:, 1:-1] - wide[:, :, :-2, 1:-1]) / 2


def _over_cells(image: Tensor) -> Tensor:
    """Mean [B, 1, H/8, W/8] over colours and cells."""
    return functional.avg_pool2d(image.mean(dim=1, keepdim=True), CELL_PX)


def _blurred(image: Tensor, side: int) -> Tensor:
    """A box of an odd ``side`` over ``image`` [B, C, H, W], its border repeated."""
    return functional.avg_pool2d(functional.pad(image, (side // 2,) * 4, mode="replicate"), side, stride=1)
