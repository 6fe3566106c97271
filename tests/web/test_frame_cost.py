"""What a frame costs the web client's worker, by CPU time: 60,000 splats that all move, and a clip of which some do."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cags_common.bundle import BundleReader
from cags_common.bundle.manifest import Manifest, MotionSteps
from cags_common.motion import chunk
from cags_common.store.tile_decode import Arrival
from cags_common.store.tile_store import TileStore
from cags_common.tiles.lod import LodLayer
from cags_common.tiles.payloads import PositionGrid, encode_base
from cags_encoder import EncodeSettings, encode
from cags_encoder.scenes import open_scene
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


@pytest.mark.slow
def test_the_frames_of_a_clip_tell_of_the_rows_that_pythons_do(tmp_path: Path) -> None:
    url = str(tmp_path / "room.cags")
    encode(open_scene("procedural:size=6000"), EncodeSettings(frames=9), url)
    with BundleReader.open(url) as reader:
        clip = played(reader)
    standing = 6_000 - sum(moved for moved, _ in clip["told"]) / len(clip["told"])
    assert standing > 3_000, "most of the room stands"
    print(run_tests("clip", tmp_path, clip=clip))


def played(reader: BundleReader) -> dict[str, Any]:
    """A bundle with every level, and how many rows Python's store tells of in each frame after the first."""
    store, frames, told = TileStore(reader.manifest, reader.codec), [], []
    for frame in range(reader.manifest.frames):
        tiles = [
            [reader.payload(frame, entry.tile, lod) for lod in range(len(entry.lod_bytes))]
            for entry in reader.frame(frame).tiles
        ]
        store.add_all([Arrival(frame, i, 0, [memoryview(level) for level in tile]) for i, tile in enumerate(tiles)])
        store.end(frame, np.zeros(0, np.int32))  # lives say when splats of clips with motion end
        frames.append({"tiles": [[text(level) for level in tile] for tile in tiles]})
    for frame in range(reader.manifest.frames):
        _, committed = store.commit(frame)
        told.append((len(committed.moved), len(committed.rows)))
    manifest, codebooks = reader.manifest.public_json().decode(), text(reader.codebooks())
    return {"manifest": manifest, "codebooks": codebooks, "frames": frames, "told": told[1:]}
