"""Counts the rows that a clip's frames upload to a renderer, and estimates uploads if the device evaluated motion.

A row that only moved takes 36 bytes (index, position, opacity and rotation); a row that changed otherwise takes all its
columns. A device that evaluates motion would get each chunk once: for every splat that moves, its row, its state before
motion, its units, and a 32-bit number for each component of each sample. Moved rows would then cost nothing per frame,
and changed rows only their other columns.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cags_bench.jsonl import JsonObject
from cags_common.bundle import BundleReader
from cags_common.motion.chunk import Chunk
from cags_common.motion.parts import in_motion
from cags_common.splats import Splats
from cags_common.store.gof_buffer import Committed
from cags_common.store.tile_decode import Arrival
from cags_common.store.tile_store import TileStore
from cags_common.tiles.kinds import TileKind

NO_IDS = np.zeros(0, np.int32)

MOVED_BYTES, MOVING_COLUMNS_BYTES = 36, 32
STATE_BYTES = 44
"""Per splat of a chunk on a device: row, position, opacity, rotation, and the units of positions and rotations."""


@dataclass
class _Counts:
    """Sums over the frames after the first of each group."""

    frames: int = 0
    moved: int = 0
    changed: int = 0
    differ: int = 0
    unreported: int = 0
    seconds: float = 0.0


def frame_uploads(reader: BundleReader) -> JsonObject:
    """Means over a clip's frames that do not begin a group, with every level, in playback order."""
    manifest = reader.manifest
    store, counts = TileStore(manifest, reader.codec), _Counts()
    before: NDArray[np.uint32] | None = None
    for frame in range(manifest.frames):
        for error in store.add_all(_arrivals(reader, frame)) + store.flush():
            raise error
        store.end(frame, reader.removed_ids(frame) if manifest.motion is None else NO_IDS)  # lives end splats
        begun = time.thread_time()
        shown, committed = store.commit(frame)
        seconds = time.thread_time() - begun
        now = _words(shown.splats)
        if before is not None and not committed.fresh:
            _count(counts, committed, before, now)
            counts.seconds += seconds
        before = now
    row = 4 * (1 + (0 if before is None else before.shape[1]))
    n = max(counts.frames, 1)
    return {
        "rows_moved_a_frame": round(counts.moved / n),
        "rows_changed_a_frame": round(counts.changed / n),
        "rows_that_differ_a_frame": round(counts.differ / n),
        "rows_that_differ_and_are_not_told_of": counts.unreported,
        "upload_bytes_a_frame": round((MOVED_BYTES * counts.moved + row * counts.changed) / n),
        "upload_bytes_a_frame_device_motion": round(
            (_chunk_bytes(reader) + (row - MOVING_COLUMNS_BYTES) * counts.changed) / n
        ),
        "commit_cpu_ms": round(1e3 * counts.seconds / n, 3),
    }


def _arrivals(reader: BundleReader, frame: int) -> list[Arrival]:
    return [
        Arrival(frame, e.tile, 0, [memoryview(reader.payload(frame, e.tile, lod)) for lod in range(len(e.lod_bytes))])
        for e in reader.frame(frame).tiles
    ]


def _words(splats: Splats) -> NDArray[np.uint32]:
    """Bits of every column [N, words]."""
    columns = [np.ascontiguousarray(array, np.float32).reshape(len(splats), -1) for _, array in splats.arrays()]
    return np.concatenate(columns, axis=1).view(np.uint32)


def _count(counts: _Counts, committed: Committed, before: NDArray[np.uint32], now: NDArray[np.uint32]) -> None:
    differ = (before != now).any(axis=1)
    reported = np.zeros(len(now), bool)
    reported[committed.rows] = reported[committed.moved] = True
    counts.frames += 1
    counts.moved += len(committed.moved)
    counts.changed += len(committed.rows)
    counts.differ += int(differ.sum())
    counts.unreported += int((differ & ~reported).sum())


def _chunk_bytes(reader: BundleReader) -> int:
    """Bytes of all chunks together."""
    total = 0
    for frame in range(reader.manifest.frames):
        for entry in reader.frame(frame).tiles:
            if entry.kind == TileKind.MOTION:
                state = reader.open_tile(frame, entry.tile)
                for lod in range(1, len(entry.lod_bytes)):
                    state.add_layer(lod, reader.payload(frame, entry.tile, lod))
                chunk = state.chunk  # type: ignore[union-attr]
                total += _device_bytes(chunk)
    return total


def _device_bytes(chunk: Chunk) -> int:
    moving = in_motion(chunk)
    count = chunk.splats if moving is None else len(moving.splats)
    parts = 3 * (chunk.moves is not None) + 4 * (chunk.turns is not None)
    return count * (STATE_BYTES + 4 * parts * (chunk.span + 1))
