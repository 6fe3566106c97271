"""A clip of two small groups of frames, of which tests make tiles by hand and read splats back."""

from __future__ import annotations

import itertools

import numpy as np

from cags_common.bundle.manifest import Manifest
from cags_common.motion.apply import ABSENT_LOGIT
from cags_common.store.tile_store import TileStore
from cags_common.tiles.lod import LodLayer
from cags_common.tiles.payloads import PositionGrid, encode_base, encode_layer
from cags_common.tiles.svq import Codebook, CodebookSet

CAPACITY = 12
ATTRIBUTES = {"scale": 3, "rotation_real": 1, "rotation_imag": 3, "opacity": 1, "sh0": 3}
ORDER = (LodLayer("sh0", 1), LodLayer("opacity", 1))


def books() -> CodebookSet:
    """Two-bit bases, one-bit enhancements; the value is the code, so that tests can read it back."""
    made = {}
    for name, dim in ATTRIBUTES.items():
        bits = (2, 1) if name in ("sh0", "opacity") else (2,)
        tables = [
            np.repeat(np.arange(1 << total, dtype=np.float32)[:, None], dim, axis=1)
            for total in itertools.accumulate(bits)
        ]
        made[name] = Codebook(name, bits, tuple(tables))
    return CodebookSet(made)


def manifest(frames: int = 8, starts: tuple[int, ...] = (0, 4)) -> Manifest:
    return Manifest(
        name="test",
        fps=30.0,
        frames=frames,
        gof_starts=starts,
        capacity=(CAPACITY,) * len(starts),
        sh_degree=0,
        bounds=((0, 0, 0), (1, 1, 1)),
        lod_order=ORDER,
        lod_gains_db=(),
        codec="svq",
    )


def base(ids: list[int], value: float, code: int = 1) -> memoryview:
    """LoD 0 of splats at x = value."""
    means = np.full((len(ids), 3), value, np.float32)
    codes = {name: np.full(len(ids), code, np.uint32) for name in ATTRIBUTES}
    grid = PositionGrid(np.zeros(3, np.float32), 1.0, 16)
    return memoryview(encode_base(np.array(ids, np.int32), means, codes, grid, books(), id_range=False))


def layer(count: int, bit: int) -> memoryview:
    return memoryview(encode_layer(np.full(count, bit, np.uint32), 1))


def removed(*ids: int) -> np.ndarray:
    return np.array(ids, np.int32)


def xs(store: TileStore, frame: int) -> list[float]:
    """x of every row after committing ``frame``; -1 where there is no splat."""
    gof, _ = store.commit(frame)
    alive = gof.splats.logit_opacities > ABSENT_LOGIT
    return np.where(alive, gof.splats.means[:, 0], -1.0).tolist()
