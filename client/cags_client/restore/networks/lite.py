"""``lite``: a small network on an unshuffled image, quick enough for a frame on two CPU cores.

Full-resolution convolutions are what makes restoration slow on a CPU. Here everything is seen at half resolution (see
:mod:`.inputs`), blocks of 2 x 2 of that - about one reference pixel - become channels (space to depth), and the only
wide receptive field is at 1/8 resolution:

    features [h, w, 7] at 1/2 -- blocks of 2 --> 1x1 --> blocks of 2 --> 1x1 --> 3x3 body at 1/8 --> 1x1 --> unblock
                                                  '---------------------- skip --------------------------------> +
    change [h, w, 3] at 1/2 <-- times support <-- plus evidence <-- unblock <-- 1x1 <----------------------------'
    restored = clip(distorted + change, brought up to full resolution)

So an untrained network takes the reference's low frequencies as they are, and training finds out how far to believe
them, and along which edges of the distorted picture to lay them down.

``support`` is the confidence at 1/4 resolution, spread by two cells and smoothed: a pixel that the reference does not
show, but has shown ones beside it, may be corrected like them (an occluded edge); where nothing near is shown, it is 0
and the distorted picture stays, bit for bit.

Inside, images are [B, H, W, C]: 1x1 convolutions are then plain matrix products, which eager torch runs several times
faster than its 1x1 convolutions on the CPU, and blocks are copies of whole runs.
"""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor, nn
from torch.nn import functional

from cags_client.restore.networks.inputs import CHANNELS

SLOPE = 0.1
"""Of the leaky rectifiers."""

_CONFIDENCE = CHANNELS - 1
_SPREAD_CELLS = 5


@dataclass(frozen=True)
class LiteShape:
    """Widths and depth: what makes the network dearer or cheaper."""

    width: int = 24  # channels at 1/4 resolution
    body_width: int = 32  # channels at 1/8 resolution
    body_layers: int = 4  # 3x3 convolutions at 1/8 resolution; even


class Lite(nn.Module):
    """See the module's text."""

    def __init__(self, shape: LiteShape | None = None) -> None:
        super().__init__()
        s = shape or LiteShape()
        self.head = nn.Linear(4 * CHANNELS, s.width)
        self.down = nn.Linear(4 * s.width, s.body_width)
        self.body = nn.ModuleList(nn.Conv2d(s.body_width, s.body_width, 3, padding=1) for _ in range(s.body_layers))
        self.up = nn.Linear(s.body_width, 4 * s.width)
        self.tail = nn.Linear(s.width, 4 * 3)
        nn.init.zeros_(self.tail.weight)  # an untrained network takes the evidence as it is
        nn.init.zeros_(self.tail.bias)

    def forward(self, features: Tensor) -> Tensor:
        """Change [B, h, w, 3] to add to the distorted picture at half resolution, of ``features`` [B, h, w, 7].

        h and w are multiples of 4.
        """
        blocks = to_blocks(features)
        shallow = functional.leaky_relu(self.head(blocks), SLOPE, inplace=True)
        deep = functional.leaky_relu(self.down(to_blocks(shallow)), SLOPE, inplace=True).permute(0, 3, 1, 2)
        for first, second in zip(self.body[::2], self.body[1::2], strict=True):
            inner = functional.leaky_relu(first(deep), SLOPE, inplace=True)
            deep = deep + functional.leaky_relu(second(inner), SLOPE, inplace=True)
        shallow = functional.leaky_relu(shallow + from_blocks(self.up(deep.permute(0, 2, 3, 1))), SLOPE, inplace=True)
        change = (self.tail(shallow) + evidence_of(blocks)) * support(blocks[..., _CONFIDENCE::CHANNELS])
        return from_blocks(change)


def evidence_of(blocks: Tensor) -> Tensor:
    """The evidence channels [B, h, w, 4 * 3] of blocks of features [B, h, w, 4 * 7]."""
    b, h, w, _ = blocks.shape
    return blocks.reshape(b, h, w, 4, CHANNELS)[..., 3:6].reshape(b, h, w, 12)


def support(confidence: Tensor) -> Tensor:
    """How far a change may go [B, h, w, 1], from the confidences [B, h, w, 4] of each block."""
    cells = confidence.mean(dim=3)[:, None]
    reach = _SPREAD_CELLS // 2
    rows = functional.max_pool2d(cells, (_SPREAD_CELLS, 1), stride=1, padding=(reach, 0))
    spread = functional.max_pool2d(rows, (1, _SPREAD_CELLS), stride=1, padding=(0, reach))
    return functional.avg_pool2d(spread, 3, stride=1, padding=1, count_include_pad=False)[:, 0, :, :, None]


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
    """A change [B, h, w, 3] at full resolution [B, 2 h, 2 w, 3], as OpenCV's bilinear resizing has it."""
    full = functional.interpolate(change.permute(0, 3, 1, 2), scale_factor=2, mode="bilinear", align_corners=False)
    return full.permute(0, 2, 3, 1)
