"""Encoding tiles of the video codec."""

from __future__ import annotations

import numpy as np

from cags_common.baselines.cloud import encode_head
from cags_common.baselines.video import KIND, VideoTile, encode_video
from cags_common.lod import LodLayer
from cags_common.splats import Ids
from cags_common.tiles import PositionGrid
from cags_encoder.baselines.scalar import ByteSplats, ScalarCodec
from cags_encoder.codecs import EncodedTile

CRFS = (38, 30, 22, 12)
"""x264's constant quality of each level. Few: what was sent at a lower one is wasted when a better one follows."""


class VideoCodec(ScalarCodec):
    """Tiles coded whole at several qualities."""

    lod_order = tuple(LodLayer("video", level) for level in range(1, len(CRFS)))

    def _tile(self, ids: Ids, coded: ByteSplats, grid: PositionGrid, *, id_range: bool) -> EncodedTile:
        numbers = np.concatenate(coded.columns, axis=1)
        head = encode_head(KIND, ids, grid, id_range=id_range)
        payloads = encode_video(head, numbers, grid.quantise(coded.means), grid.bits, CRFS)
        return EncodedTile(tuple(payloads), VideoTile(payloads[-1], self.book).dequantise())
