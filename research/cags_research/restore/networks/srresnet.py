"""The restoration network of the paper's authors, as a tier and as the baselines with one input.

[reference, distorted] -> 3x3 convolution of 24 channels, LeakyReLU 0.1 -> 4 residual blocks (3x3, LeakyReLU, 3x3; no
batch norm) -> two more convolutions with LeakyReLU -> 3x3 convolution to RGB, plus the reference. At full resolution:
54,051 weights, 103 GMAC at 1600x1200 (Ledig et al. 2017, made light; FINDINGS of this project).

``srresnet`` may have a gate (:mod:`cags_research.restore.networks.gate`; 3,556 weights more), which says how much of
its answer is shown in place of the distorted picture, by the PSNR that this should have. The paper has none: its
network is given two pictures and decides that itself. ``SrResNet(gated=False)`` is the paper's.

``sr-align-ref`` sees the aligned reference alone (super-resolution), ``cr-no-ref`` the distorted picture alone (colour
restoration without a reference, which it then adds to).
"""

from __future__ import annotations

from enum import StrEnum

import torch
from torch import Tensor, nn
from torch.nn import functional

from cags_research.restore.networks.gate import ErrorGate

WIDTH = 24
BLOCKS = 4
SLOPE = 0.1


class Sees(StrEnum):
    """Which pictures the network is given."""

    BOTH = "both"
    REFERENCE = "reference"
    DISTORTED = "distorted"


class SrResNet(nn.Module):
    """See the module's text. Images are [B, H, W, 3] of any size, as the program keeps them."""

    def __init__(self, sees: Sees = Sees.BOTH, *, gated: bool = False) -> None:
        super().__init__()
        if gated and sees is not Sees.BOTH:
            raise ValueError(f"a gate weighs two pictures: a network that sees {sees.value} alone has none")
        self.sees = sees
        self.head = _convolution(6 if sees is Sees.BOTH else 3, WIDTH)
        self.blocks = nn.ModuleList(ResidualBlock() for _ in range(BLOCKS))
        self.mix = nn.ModuleList([_convolution(WIDTH, WIDTH), _convolution(WIDTH, WIDTH)])
        self.tail = _convolution(WIDTH, 3)
        nn.init.zeros_(self.tail.weight)  # an untrained network shows the picture that it adds to
        assert self.tail.bias is not None
        nn.init.zeros_(self.tail.bias)
        self.gate = ErrorGate() if gated else None
        if sees is Sees.BOTH:
            self._start_at_distorted()

    @torch.no_grad()
    def _start_at_distorted(self) -> None:
        """Six channels carry distorted - reference, both signs, to the end: untrained, it shows the distorted picture.

        Begun at the reference, which lies decibels below it, training on a CPU spends its hours on getting back.
        """
        carried = range(2 * 3)
        last_of_blocks = (block.second for block in self.blocks if isinstance(block, ResidualBlock))
        for convolution in (self.head, *last_of_blocks, *self.mix):
            _clear(convolution, carried)
        for channel in carried:
            colour, sign = channel // 2, 1.0 - 2.0 * (channel % 2)
            self.head.weight[channel, 3 + colour, 1, 1] = sign
            self.head.weight[channel, colour, 1, 1] = -sign
            for convolution in self.mix:
                assert isinstance(convolution, nn.Conv2d)
                convolution.weight[channel, channel, 1, 1] = 1.0
            self.tail.weight[colour, channel, 1, 1] = sign / (1.0 + SLOPE ** (1 + len(self.mix)))

    @torch.no_grad()
    def start_at_blurred(self) -> None:
        """Six more channels add the blurred difference, reference - distorted: untrained, what is shown has the
        colours of the reference and the detail of the client's own picture.

        A pair of channels holds p and q with p - q = (1 + slope) v; each of the residual blocks adds half of
        (box - 1)(p - q) to p and takes it from q, each convolution after them is a box: six 3x3 boxes of v.
        """
        carried = range(6, 12)
        box = torch.full((3, 3), 1 / 9)
        centre = functional.pad(torch.ones(1, 1), (1, 1, 1, 1))
        _clear(self.head, carried)
        for block in self.blocks:
            assert isinstance(block, ResidualBlock)
            _clear(block.first, carried)
            _clear(block.second, carried)
            _difference_of_pairs(block.first, (box - centre) / 2)
            _difference_of_pairs(block.second, centre / (1 + SLOPE))
        for convolution in self.mix:
            _clear(convolution, carried)
            _difference_of_pairs(convolution, box / (1 + SLOPE))
        for channel in carried:
            colour, sign = (channel - 6) // 2, 1.0 - 2.0 * (channel % 2)
            self.head.weight[channel, colour, 1, 1] = sign
            self.head.weight[channel, 3 + colour, 1, 1] = -sign
            self.tail.weight[colour, channel, 1, 1] = sign / (1 + SLOPE)

    def forward(self, aligned: Tensor, distorted: Tensor, expected_db: Tensor | None = None) -> Tensor:
        """The restored picture before clipping: the loss looks at this, so that no gradient dies.

        ``expected_db`` [B, 1, 1, 1] is the PSNR expected of ``distorted``, for the gate. :class:`ValueError` is raised
        where there is a gate and no such PSNR.
        """
        base = distorted if self.sees is Sees.DISTORTED else aligned
        seen = torch.cat([aligned, distorted], dim=3) if self.sees is Sees.BOTH else base
        features = functional.leaky_relu(self.head(seen.permute(0, 3, 1, 2)), SLOPE, inplace=True)
        for block in self.blocks:
            features = block(features)
        for convolution in self.mix:
            features = functional.leaky_relu(convolution(features), SLOPE, inplace=True)
        restored: Tensor = base + self.tail(features).permute(0, 2, 3, 1)
        if self.gate is not None:
            if expected_db is None:
                raise ValueError(
                    "expected_db = None: a network with a gate needs the expected PSNR of what is on screen"
                )
            restored = self.gate(aligned, distorted, restored, expected_db)
        return restored


class ResidualBlock(nn.Module):
    """x + conv(leaky(conv(x))), no normalisation."""

    def __init__(self) -> None:
        super().__init__()
        self.first, self.second = _convolution(WIDTH, WIDTH), _convolution(WIDTH, WIDTH)

    def forward(self, features: Tensor) -> Tensor:
        """[B, 24, H, W] to the same shape."""
        inner: Tensor = self.second(functional.leaky_relu(self.first(features), SLOPE, inplace=True))
        return features + inner


def _clear(convolution: nn.Module, channels: range) -> None:
    assert isinstance(convolution, nn.Conv2d)
    assert convolution.bias is not None
    for channel in channels:
        convolution.weight[channel] = 0.0
        convolution.bias[channel] = 0.0


def _difference_of_pairs(convolution: nn.Module, kernel: Tensor) -> None:
    """Channels 6 to 11: the first of a pair is ``kernel`` over the difference of its two, the second the negative."""
    assert isinstance(convolution, nn.Conv2d)
    for first in (6, 8, 10):
        for out, sign in ((first, 1.0), (first + 1, -1.0)):
            convolution.weight[out, first] = sign * kernel
            convolution.weight[out, first + 1] = -sign * kernel


def _convolution(inputs: int, outputs: int) -> nn.Conv2d:
    return nn.Conv2d(inputs, outputs, 3, padding=1)
