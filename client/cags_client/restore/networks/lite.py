"""``lite``: a small network that improves the closed form's correction where it is made, in the reference's view.

The closed form (:mod:`cags_client.restore.affine`) turns the reference and the client's own splats seen from there into
a field of factors and offsets, [h, w, 4], which is brought to the client's view. It tells quantisation from the codec's
noise by local powers alone. What is left to gain is mostly there: with references that were never coded it would gain
1.5 dB more on the mean. So the network sees both pictures side by side, free of parallax, and the field, and answers
with a change to the field; all that follows is the closed form's. Its cost does not depend on the display's size.

    own, reference - own, correction, factor --> blocks of 2 x 2 --> 1x1 (+ noise) --> 3x3 body --> 3x3 --> unblock
    field + gate * change

An untrained network *is* the closed form. The gate is part of the graph, so that training sees it: where the closed
form corrects nothing nearby - near the top of the ladder - it is exactly 0 and the distorted picture stays, bit for
bit, whatever the weights are; where it corrects half a display code the gate is nearly open. How far it may go is
bounded by the coding noise.

Outside, images are [B, h, w, C]; inside, blocks are channels (space to depth), so that the convolutions run at 200x150.

The same network is in ``kernels/src/native/lite``, which the client runs: what changes here changes there.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from cags_client.restore.affine import NOISE_FLOOR
from cags_client.restore.networks.bounds import FACTOR_REACH, REACH, USUAL_DEVIATION

SLOPE = 0.1
"""Of the leaky rectifiers."""

GATE_HALF = 5e-4
"""Mean correction of the closed form, in [0, 1], at which the gate is half open: an eighth of a display code."""

_GATE_CELLS = 5

SEEN_CHANNELS = 10
"""Own RGB, difference RGB, correction RGB, factor."""

FIELD_CHANNELS = 4
NOISE_CHANNELS = 6

FAINT = 8.0
"""By how much faint channels count for more than colours: differences going in, corrections coming out."""


@dataclass(frozen=True)
class LiteShape:
    """Widths and depth: what makes the network dearer or cheaper."""

    width: int = 24
    layers: int = 6  # 3x3 convolutions of the body; even


class Lite(nn.Module):
    """See the module's text."""

    def __init__(self, shape: LiteShape | None = None) -> None:
        super().__init__()
        s = shape or LiteShape()
        self.head = nn.Linear(4 * SEEN_CHANNELS, s.width)  # a matrix product: eager torch's 1x1 convolutions are slower
        self.noise = nn.Linear(NOISE_CHANNELS, s.width, bias=False)
        self.body = nn.ModuleList(nn.Conv2d(s.width, s.width, 3, padding=1) for _ in range(s.layers))
        self.tail = nn.Conv2d(s.width, 4 * FIELD_CHANNELS, 3, padding=1)
        nn.init.zeros_(self.tail.weight)  # an untrained network takes the closed form as it is
        assert self.tail.bias is not None
        nn.init.zeros_(self.tail.bias)

    def forward(self, own: Tensor, reference: Tensor, fields: Tensor, noise: Tensor) -> Tensor:
        """Fields [B, h, w, 4] in place of the closed form's ``fields``; h and w are even.

        ``own`` and ``reference`` are [B, h, w, 3] in [0, 1], ``noise`` [B, 1, 1, 6] of
        :func:`~cags_client.restore.networks.inputs.noise_features`.
        """
        factor, offset = fields[..., :1], fields[..., 1:]
        correction = own * factor + offset
        seen = torch.cat([own, FAINT * (reference - own), FAINT * correction, factor], dim=3)
        features = functional.leaky_relu(self.head(to_blocks(seen)) + self.noise(noise), SLOPE).permute(0, 3, 1, 2)
        for first, second in zip(self.body[::2], self.body[1::2], strict=True):
            inner = functional.leaky_relu(first(features), SLOPE)
            features = features + functional.leaky_relu(second(inner), SLOPE)
        answer = (self.tail(features) * gate(correction)).permute(0, 2, 3, 1)
        change = from_blocks(answer)
        more, less = bounded(change[..., 1:] / FAINT, REACH * spread(noise)), bounded(change[..., :1], FACTOR_REACH)
        return torch.cat([factor + less, offset + more - less * own], dim=3)


def bounded(value: Tensor, bound: Tensor | float) -> Tensor:
    """``value``, drawn together so that its size stays below ``bound``."""
    return bound * torch.tanh(value / bound)


def spread(noise: Tensor) -> Tensor:
    """Standard deviation [B, 1, 1, 1] of coding noise, about, from its features [B, 1, 1, 6]."""
    variance = torch.pow(10.0, noise - 4.0)
    fine, broad = variance[..., :3].mean(dim=3, keepdim=True), variance[..., 3:].mean(dim=3, keepdim=True)
    return torch.sqrt(broad + USUAL_DEVIATION * fine + NOISE_FLOOR)


def gate(correction: Tensor) -> Tensor:
    """How far the network may go [B, 1, h / 2, w / 2] in [0, 1), from the closed form's correction [B, h, w, 3]."""
    power = to_blocks(correction.abs()).mean(dim=3)[:, None]
    near = functional.avg_pool2d(power, _GATE_CELLS, stride=1, padding=_GATE_CELLS // 2, count_include_pad=False)
    return near / (near + GATE_HALF)


def to_blocks(image: Tensor) -> Tensor:
    """Space to depth: [B, H, W, C] -> [B, H / 2, W / 2, 4 C], channels in order (row, column, C)."""
    b, h, w, c = image.shape
    split = image.reshape(b, h // 2, 2, w // 2, 2 * c)
    return split.permute(0, 1, 3, 2, 4).reshape(b, h // 2, w // 2, 4 * c)


def from_blocks(image: Tensor) -> Tensor:
    """Depth to space, the inverse of :func:`to_blocks`."""
    b, h, w, c = image.shape
    return image.reshape(b, h, w, 2, c // 2).permute(0, 1, 3, 2, 4).reshape(b, 2 * h, 2 * w, c // 4)
