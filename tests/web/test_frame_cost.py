"""What a frame costs the web client's worker: 60,000 splats that move in every frame, by CPU time."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cags_common.bundle.manifest import Manifest, MotionSteps
from cags_common.motion import chunk
from cags_common.tiles.lod import LodLayer
from cags_common.tiles.payloads import PositionGrid, encode_base
from support.codec_scenes import books
from support.node import run_tests
from support.store_scripts import text

TILES, SPLATS, SPAN = 10, 6_000, 8
BOOKS = books((4, 2))


@pytest.mark.slow
def test_a_frame_of_sixty_thousand_moving_splats(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    order = tuple(LodLayer(name, 1) for name in BOOKS.attributes)
    steps = MotionSteps((0.002,) * 16, (0.002,) * 16)
    count = TILES * SPLATS
    box = (-5.0, -5.0, -5.0), (5.0, 5.0, 5.0)
    info = Manifest("cost", 30.0, SPAN + 1, (0,), (count,), 0, box, order, (), "svq", "paper-66", motion=steps)
    looks, motions = [], []
    for tile in range(TILES):
        ids = np.arange(tile * SPLATS, (tile + 1) * SPLATS, dtype=np.int32)
        means = np.sort(rng.uniform(-5, 5, (SPLATS, 3)), axis=0).astype(np.float32)
        base = {name: rng.integers(0, 16, SPLATS).astype(np.uint32) for name in BOOKS.attributes}
        looks.append(encode_base(ids, means, base, PositionGrid.over(means, 12), BOOKS, id_range=True))
        moves = np.cumsum(rng.normal(0, 8, (SPAN + 1, SPLATS, 3)), axis=0)
        turns = np.cumsum(rng.normal(0, 3, (SPAN + 1, SPLATS, 4)), axis=0)
        motions.append(chunk.encode((0, tile), moves, turns, starts=False))
    scene = {
        "manifest": info.public_json().decode(),
        "codebooks": text(BOOKS.to_bytes()),
        "looks": [text(payload) for payload in looks],
        "motions": [[text(payload) for payload in levels] for levels in motions],
    }
    print(run_tests("cost", tmp_path, scene=scene))
