"""The bytes that V3-A would save by inter-frame prediction of its planes.

The ``video`` codec codes every tile as separate pictures (:mod:`cags_research.codecs.video`); V3 (Wang et al., SIGGRAPH
Asia 2024) codes planes as a video over a group of frames. :func:`saving` measures the ratio of both on a clip. Playing
V3-A over a link that is faster by this ratio gives an upper bound of what prediction could gain.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cags_common.splats import Splats
from cags_common.tiles.morton import morton_order, tile_ranges
from cags_common.tiles.payloads import KEY_TILE_SPLATS
from cags_encoder.codecs.registry import train_codec
from cags_encoder.scenes import FrameSource
from cags_encoder.settings import EncodeSettings
from cags_research.codecs.encoding.scalar import ByteSplats
from cags_research.codecs.encoding.video import CRFS, VideoCodec
from cags_research.codecs.planes import encode_plane_video
from cags_research.codecs.scalar import U8

FRAMES = 4
"""Number of frames at the beginning of the clip that are coded; the first is intra-coded in both ways."""

LOSSLESS = 0


def saving(source: FrameSource) -> float:
    """Ratio of the bytes of frames after the first, intra-coded over predicted; at least 1.

    It is measured on the splats that change within the first :data:`FRAMES` frames, at the quality with the largest
    ratio. Positions are coded without loss as high and low bytes. If rows are not identities, each frame is sorted in
    Morton order.
    """
    count = min(FRAMES, len(source))
    if count < 2:
        return 1.0
    frames = _changing([source.frame(index) for index in range(count)], known=source.ids(0) is not None)
    if not len(frames[0]):
        return 1.0
    codec = train_codec(frames[0], EncodeSettings(codec="video"))
    assert isinstance(codec, VideoCodec)
    alone, together = np.zeros(len(CRFS)), np.zeros(len(CRFS))
    for first, end in tile_ranges(len(frames[0]), KEY_TILE_SPLATS):
        tiles = [codec.quantise(frame).take(np.arange(first, end)) for frame in frames]
        alone += _by_itself(codec, tiles)
        together += _predicted(codec, tiles)
    return max(1.0, float((alone / together).max()))


def _changing(frames: Sequence[Splats], *, known: bool) -> list[Splats]:
    """The rows that change between the frames, in Morton order; the same number in each frame."""
    least = min(map(len, frames))
    if known:
        moved = np.zeros(least, bool)
        for frame in frames[1:]:
            for ours, first in ((frame.means, frames[0].means), (frame.quats, frames[0].quats)):
                moved |= (ours[:least] != first[:least]).any(axis=1)
        order = np.flatnonzero(moved)
        order = order[morton_order(frames[0].means[order])]
        return [frame.take(order) for frame in frames]
    return [frame.take(morton_order(frame.means)[:least]) for frame in frames]


def _by_itself(codec: VideoCodec, tiles: Sequence[ByteSplats]) -> np.ndarray:
    """Bytes [qualities] of the frames after the first, as separate tiles."""
    ids = np.arange(len(tiles[0].means), dtype=np.int32)
    sizes = [[len(p) for p in codec.encode_tile(ids, tile, id_range=True)] for tile in tiles[1:]]
    return np.array([sum(of_quality) for of_quality in zip(*sizes, strict=True)])


def _predicted(codec: VideoCodec, tiles: Sequence[ByteSplats]) -> np.ndarray:
    """Bytes [qualities] of the same frames with inter-frame prediction."""
    low, high = (pick(np.stack([pick(tile.means, axis=0) for tile in tiles]), axis=0) for pick in (np.min, np.max))
    grid = codec.grid(ByteSplats(np.stack([low, high]).astype(np.float32), ()))
    cells = [grid.quantise(tile.means) for tile in tiles]
    places = [_bytes_of(cell) for cell in cells]
    positions = sum(map(len, encode_plane_video(places, LOSSLESS)[1:]))
    numbers = [np.concatenate(tile.columns, axis=1) for tile in tiles]
    return np.array([positions + sum(map(len, encode_plane_video(numbers, crf)[1:])) for crf in CRFS])


def _bytes_of(cells: np.ndarray) -> U8:
    """High and low bytes [n, 6] of grid coordinates [n, 3] of 16 bits."""
    return np.concatenate([cells >> 8, cells & 255], axis=1).astype(np.uint8)
