"""One encoded frame of a scene at any depth of its LoD ladder, and the unquantised frame that it came from."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cags_common.bundle import BundleReader, Manifest
from cags_common.bundle.codecs import MotionTile
from cags_common.bundle.reader import MANIFEST_NAME
from cags_common.geometry import Camera
from cags_common.splats import Splats
from cags_common.store.tile_decode import First, OpenTile, in_view, open_tile
from cags_common.tiles.kinds import TileKind
from cags_common.tiles.updates import UpdateState
from cags_encoder.pipeline import encode
from cags_encoder.scenes import open_scene
from cags_encoder.settings import EncodeSettings


class Ladder:
    """The first frame of a bundle, held in memory: every tile's payloads, and the source."""

    def __init__(self, reader: BundleReader) -> None:
        self.manifest: Manifest = reader.manifest
        self.truth: Splats = reader.source(0).splats
        self._codec = reader.codec
        looks = [tile for tile in reader.frame(0).tiles if tile.kind is TileKind.LOOKS]  # motion begins at rest
        self._payloads = [[reader.payload(0, t.tile, lod) for lod in range(len(t.lod_bytes))] for t in looks]
        self._opened = [
            self._bare(First((0, t.tile), 0, memoryview(payloads[0])))
            for t, payloads in zip(looks, self._payloads, strict=True)
        ]

    def _bare(self, base: First) -> OpenTile:
        """Where a tile is and how many splats it has."""
        opened = open_tile(self._codec, base)
        assert isinstance(opened, OpenTile)
        return opened

    @classmethod
    def of_scene(cls, spec: str, settings: EncodeSettings) -> Ladder:
        """Encode the first frame of the scene that ``spec`` names; a bundle's is taken as it is.

        Raises what opening and encoding raise.
        """
        if is_bundle(spec):
            with BundleReader.open(spec) as reader:
                return cls(reader)
        with tempfile.TemporaryDirectory(prefix="cags-pairs-") as folder:
            url = str(Path(folder) / "scene.cags")
            encode(open_scene(spec), replace(settings, frames=1), url)
            with BundleReader.open(url) as reader:
                return cls(reader)

    @property
    def tiles(self) -> int:
        """Number of tiles of splats."""
        return len(self._payloads)

    @property
    def top(self) -> int:
        """The highest LoD."""
        return self.manifest.lods - 1

    def lod_mean(self, lods: Sequence[int] | NDArray[np.integer], camera: Camera) -> float:
        """What a client at ``camera`` tells of its detail with each tile at its LoD of ``lods`` [tiles]: the mean over
        the splats of tiles in view (``Shown.lod_mean``); NaN where none is.
        """
        counts = np.array([len(tile.state) for tile in self._opened], np.float64)
        weights = counts * in_view([tile.sphere for tile in self._opened], camera)
        return float((weights * np.asarray(lods)).sum() / weights.sum()) if weights.any() else float("nan")

    def at(self, lods: Sequence[int] | NDArray[np.integer]) -> Splats:
        """All splats, each tile decoded to its own LoD of ``lods`` [tiles], 0 to :attr:`top`."""
        parts = []
        for payloads, lod in zip(self._payloads, lods, strict=True):
            tile = self._codec.open_tile(payloads[0])
            assert not isinstance(tile, MotionTile | UpdateState)
            for level in range(1, int(lod) + 1):
                tile.add_layer(level, payloads[level])
            parts.append(tile.dequantise())
        return Splats.concatenate(parts)


def is_bundle(spec: str) -> bool:
    """Whether ``spec`` names a bundle on this machine, rather than a scene."""
    return (Path(spec) / MANIFEST_NAME).is_file()


def draw_lods(rng: np.random.Generator, tiles: int, top: int, top_share: float = 0.0) -> NDArray[np.int64]:
    """LoDs [tiles] as a stream leaves them: one level for all, drawn over the ladder, and tiles that differ by some.

    Pictures get better by about the root of the LoD (27, 38, 45 and 51 dB at 0, 0.3, 0.6 and 1 of the ladder), so the
    root is what is drawn evenly: every decibel comes as often. One draw in four is level for all tiles; of
    ``top_share`` of the draws the middle is the top of the ladder.
    """
    middle = float(top) if rng.random() < top_share else top * rng.random() ** 2
    spread = 0.0 if rng.random() < 0.25 else rng.uniform(0.0, top / 4)
    drawn = np.rint(rng.normal(middle, spread, tiles)).astype(np.int64)
    return np.clip(drawn, 0, top)
