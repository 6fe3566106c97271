"""Encoding tiles of the video codec."""

from __future__ import annotations

import numpy as np

from cags_common.splats import Ids, Splats
from cags_common.tiles.lod import LodLayer
from cags_research.codecs.cloud import encode_head
from cags_research.codecs.encoding.scalar import ByteSplats, ScalarCodec
from cags_research.codecs.video import KIND, VideoTile, encode_video

CRFS = (38, 30, 22, 12)
"""x264's constant quality of each level. Few: what was sent at a lower one is wasted when a better one follows."""


class VideoCodec(ScalarCodec):
    """Tiles coded whole at several qualities."""

    lod_order = tuple(LodLayer("video", level) for level in range(1, len(CRFS)))

    def opened(self, payload: bytes) -> VideoTile:
        """A tile, from its payload at any quality."""
        return VideoTile(payload, self.book)

    def shown(self, coded: ByteSplats) -> Splats:
        """One tile at the best quality, which is not without loss."""
        ids = np.arange(len(coded.means), dtype=np.int32)
        best = self._payloads(ids, coded, CRFS[-1:], id_range=True)[0]
        return VideoTile(best, self.book).dequantise()

    def encode_tile(self, ids: Ids, coded: ByteSplats, *, id_range: bool) -> tuple[bytes, ...]:
        """Encode a tile of splats [n] with ascending ``ids``."""
        return tuple(self._payloads(ids, coded, CRFS, id_range=id_range))

    def _payloads(self, ids: Ids, coded: ByteSplats, crfs: tuple[int, ...], *, id_range: bool) -> list[bytes]:
        numbers, grid = np.concatenate(coded.columns, axis=1), self.grid(coded)
        head = encode_head(KIND, ids, grid, id_range=id_range)
        return encode_video(head, numbers, grid.quantise(coded.means), grid.bits, crfs)
