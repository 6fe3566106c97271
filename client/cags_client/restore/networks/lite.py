"""``lite``: a small network on an unshuffled image, quick enough for a frame on two CPU cores.

It finds what the closed form (:mod:`cags_client.restore.affine`) leaves: an untrained one shows the closed form's
picture. Full-resolution convolutions are what makes restoration slow on a CPU. Here everything is seen at half
resolution (see :mod:`.inputs`), blocks of 2 x 2 of that - about one reference pixel - become channels (space to depth),
and the only wide receptive field is at 1/8 resolution:

    blocks of 2 x 2 of features at 1/2 --> 1x1 --> blocks of 2 --> 1x1 --> 3x3 body at 1/8 --> 1x1 --> unblock
                                            '---------------------- skip --------------------------------> +
    blocks of the change at 1/2 <------------------- times gate <------------------------ 1x1 <------------'
    restored = clip(closed form + change, brought up to full resolution)

The gate is part of the graph, so that training sees it. The closed form tells signal from the codec's noise by Wiener
weights and by the evidence of the whole picture; how much it changes nearby says how much of either there is. Where it
changes nothing - near the top of the ladder, or where no reference is - the gate is exactly 0 and the distorted picture
stays, bit for bit; where it changes half a display code the gate is nearly open. How much the whole frame is changed is
one of the features: it tells a badly distorted frame from a good one with a noisy reference.

Inside, images are [B, H, W, C]: 1x1 convolutions are then plain matrix products, which eager torch runs several times
faster than its 1x1 convolutions on the CPU, and blocks are copies of whole runs.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from cags_client.restore.networks.inputs import BLOCK_CHANNELS, CHANNELS, CONFIDENCE, POWER

SLOPE = 0.1
"""Of the leaky rectifiers."""

GATE_HALF = 5e-4
"""Mean change of the closed form, in [0, 1] of display range, at which the gate is half open: an eighth of a code."""

_GATE_CELLS = 5

_FAINT = 8.0
"""By how much faint channels (evidence, change) count for more than colours in an untrained network."""


@dataclass(frozen=True)
class LiteShape:
    """Widths and depth: what makes the network dearer or cheaper."""

    width: int = 24  # channels at 1/4 resolution
    body_width: int = 24  # channels at 1/8 resolution
    body_layers: int = 4  # 3x3 convolutions at 1/8 resolution; even


class Lite(nn.Module):
    """See the module's text."""

    def __init__(self, shape: LiteShape | None = None) -> None:
        super().__init__()
        s = shape or LiteShape()
        self.head = nn.Linear(BLOCK_CHANNELS, s.width)
        self.down = nn.Linear(4 * s.width, s.body_width)
        self.body = nn.ModuleList(nn.Conv2d(s.body_width, s.body_width, 3, padding=1) for _ in range(s.body_layers))
        self.up = nn.Linear(s.body_width, 4 * s.width)
        self.tail = nn.Linear(s.width, 4 * 3)
        with torch.no_grad():
            self.head.weight[:, :CONFIDENCE].view(s.width, 4, CHANNELS - 1)[..., 3:] *= _FAINT
            self.head.weight[:, POWER:] *= 2 * _FAINT
        nn.init.zeros_(self.tail.weight)  # an untrained network takes the closed form as it is
        nn.init.zeros_(self.tail.bias)

    def forward(self, blocks: Tensor) -> Tensor:
        """Change in blocks [B, h, w, 12] to add to the closed form's picture, of ``blocks`` [B, h, w, 39].

        h and w, at a quarter of the display's resolution, are even.
        """
        shallow = functional.leaky_relu(self.head(blocks), SLOPE, inplace=True)
        deep = functional.leaky_relu(self.down(to_blocks(shallow)), SLOPE, inplace=True).permute(0, 3, 1, 2)
        for first, second in zip(self.body[::2], self.body[1::2], strict=True):
            inner = functional.leaky_relu(first(deep), SLOPE, inplace=True)
            deep = deep + functional.leaky_relu(second(inner), SLOPE, inplace=True)
        shallow = functional.leaky_relu(shallow + from_blocks(self.up(deep.permute(0, 2, 3, 1))), SLOPE, inplace=True)
        change: Tensor = self.tail(shallow) * gate(blocks)
        return change


def gate(blocks: Tensor) -> Tensor:
    """How far the network may go [B, h, w, 1] in [0, 1), from blocks of features [B, h, w, 39]."""
    power = blocks[..., POWER][:, None]
    near = functional.avg_pool2d(power, _GATE_CELLS, stride=1, padding=_GATE_CELLS // 2, count_include_pad=False)
    return (near / (near + GATE_HALF))[:, 0, :, :, None]


def to_blocks(image: Tensor) -> Tensor:
    """Space to depth: [B, H, W, C] -> [B, H / 2, W / 2, 4 C], channels in order (row, column, C)."""
    b, h, w, c = image.shape
    split = image.reshape(b, h // 2, 2, w // 2, 2 * c)
    return split.permute(0, 1, 3, 2, 4).reshape(b, h // 2, w // 2, 4 * c)


def from_blocks(image: Tensor) -> Tensor:
    """Depth to space, the inverse of :func:`to_blocks`."""
    b, h, w, c = image.shape
    return image.reshape(b, h, w, 2, c // 2).permute(0, 1, 3, 2, 4).reshape(b, 2 * h, 2 * w, c // 4)


def brought_up(change: Tensor) -> Tensor:
    """A change in blocks [B, h, w, 12] at full resolution [B, 4 h, 4 w, 3], as OpenCV's bilinear resizing has it."""
    half = from_blocks(change).permute(0, 3, 1, 2)
    full = functional.interpolate(half, scale_factor=2, mode="bilinear", align_corners=False)
    return full.permute(0, 2, 3, 1)
