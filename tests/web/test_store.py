"""The web client's store shows what Python's does, bit for bit, whatever comes in whatever order."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TypeAlias

import numpy as np
import pytest

from cags_common.geometry import Camera, Intrinsics, Pose
from cags_common.store.tile_decode import Arrival
from support.moving_bundle import write_moving
from support.mutation import mutate
from support.node import run_tests
from support.small_motion import moving, random_frames, written
from support.small_store import CAPACITY, books, manifest
from support.store_scripts import Recorder, Step, text

Ends: TypeAlias = Sequence[tuple[int, np.ndarray]]

CLIPS, ORDERS = 12, 25
FEW_CLIPS, FEW_ORDERS = 3, 15
CAMERA = Camera(Intrinsics(400, 300, 300.0, 300.0, 200.0, 150.0), Pose((0.0, 0.0, -20.0), (1.0, 0.0, 0.0, 0.0)), 0.2)


@pytest.mark.parametrize(
    ("clips", "orders"), [(FEW_CLIPS, FEW_ORDERS), pytest.param(CLIPS, ORDERS, marks=pytest.mark.slow)]
)
def test_random_orders_with_marks_jumps_and_new_connections(clips: int, orders: int, tmp_path: Path) -> None:
    scripts = [_script(seed, order, tmp_path / f"{seed}") for seed in range(clips) for order in range(orders)]
    run_tests("store", tmp_path, scripts=scripts)


@pytest.mark.parametrize("seed", [1, 2])
def test_bundles_with_lives_and_updates_in_random_order(seed: int, tmp_path: Path) -> None:
    reader = write_moving(str(tmp_path / "clip.cags"), seed)
    rng = np.random.default_rng(seed)
    scripts = []
    for order in range(10):
        record = Recorder(reader.manifest, reader.codec, CAMERA, whole=order % 2 == 0)
        messages, ends = [], []
        for frame in range(reader.manifest.frames):
            for number, tile in enumerate(reader.frame(frame).tiles):
                payloads = [memoryview(reader.payload(frame, number, lod)) for lod in range(len(tile.lod_bytes))]
                cut = int(rng.integers(1, len(payloads) + 1))
                messages += [Arrival(frame, number, 0, payloads[:cut]), Arrival(frame, number, cut, payloads[cut:])]
            ends.append((frame, reader.removed_ids(frame)))
        _play(record, rng, [m for m in messages if m.payloads], ends, reader.manifest.frames)
        scripts.append(_wrapped(reader.manifest.public_json(), bytes(reader.codebooks()), record))
    run_tests("store", tmp_path, scripts=scripts)


def _script(seed: int, order: int, folder: Path) -> Step:
    rng = np.random.default_rng(seed)
    of = moving(manifest(frames=9, starts=(0, 4)))
    frames = random_frames(rng, of)
    folder.mkdir(exist_ok=True)
    clip = written(folder / f"{order}", of, frames)
    rng = np.random.default_rng(1000 * seed + order)
    record = Recorder(of, clip.reader.codec, CAMERA, whole=order % 2 == 0)
    messages = _damaged(rng, clip.messages(rng)) if order % 5 == 4 else clip.messages(rng)
    ends = [(f, _removed(rng)) for f in range(of.frames)]
    _play(record, rng, messages, ends, of.frames)
    return _wrapped(of.public_json(), books().to_bytes(), record)


def _wrapped(info: bytes, codebooks: bytes, record: Recorder) -> Step:
    return {"manifest": info.decode(), "codebooks": text(codebooks), "whole": record.whole, "steps": record.steps}


def _removed(rng: np.random.Generator) -> np.ndarray:
    some = rng.random() < 0.3
    return (
        np.sort(rng.permutation(CAPACITY)[: int(rng.integers(1, 3))]).astype(np.int32)
        if some
        else np.zeros(0, np.int32)
    )


def _damaged(rng: np.random.Generator, messages: list[Arrival]) -> list[Arrival]:
    """Some payloads changed; Draco's own are left alone, for what it makes of damage is nobody's promise."""
    out = []
    for message in messages:
        payloads = [
            memoryview(mutate(bytes(p), rng)) if rng.random() < 0.15 and bytes(p[:1]) != b"\x02" else p
            for p in message.payloads
        ]
        out.append(Arrival(message.frame, message.tile, message.from_lod, payloads))
    return out


def _play(
    record: Recorder,
    rng: np.random.Generator,
    messages: list[Arrival],
    ends: Sequence[tuple[int, np.ndarray]],
    frames: int,
) -> None:
    """Everything comes, in any order and mostly in batches, while frames are shown by marks or without."""
    events: list[object] = [*messages, *ends]
    if rng.random() < 0.5:
        events.sort(key=lambda e: -(e.frame if isinstance(e, Arrival) else e[0]) + 3 * rng.random())  # type: ignore[index]
    else:
        rng.shuffle(events)  # type: ignore[arg-type]
    shown = marked = basis = oldest = 0
    while events:
        batch = [events.pop() for _ in range(min(len(events), int(rng.integers(1, 7))))]
        record.add([event for event in batch if isinstance(event, Arrival)])
        if rng.random() < 0.7:
            record.flush()
        for event in batch:
            if not isinstance(event, Arrival):
                record.end(*event)  # type: ignore[misc]
        if rng.random() < 0.4:
            marked += 1
            record.mark(marked)
        if rng.random() < 0.05:
            record.restarted(rng)
            basis = marked
        if rng.random() < 0.6:
            wanted = int(rng.integers(oldest, frames)) if rng.random() < 0.15 else min(shown + 1, frames - 1)
            shown = max(wanted, record.reachable)
            basis = int(rng.integers(basis, marked + 1)) if marked else 0
            record.commit(shown, basis if marked and rng.random() < 0.7 else None)
            if rng.random() < 0.4:
                record.move(shown, float(rng.random()))
        if rng.random() < 0.02:
            shown = int(rng.integers(0, frames))
            record.reset(shown)
    record.flush()
    for frame in range(record.reachable, frames):
        record.commit(frame)
        record.move(frame, 0.5)
