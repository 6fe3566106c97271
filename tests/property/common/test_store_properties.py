"""However tiles come, the client ends with what a player of the whole bundle shows, bit for bit."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from cags_common.bundle import BundlePlayer, DecodedFrame
from cags_common.motion.apply import ABSENT_LOGIT
from cags_common.motion.chunk import LEVELS
from cags_common.store.gof_buffer import GofBuffer
from cags_common.store.tile_store import TileStore
from support.examples import examples
from support.small_motion import Clip, moving, random_frames, written
from support.small_store import manifest

NONE = np.zeros(0, np.int32)


def assert_shows(store: GofBuffer, wanted: DecodedFrame, what: str) -> None:
    ids = np.flatnonzero(store.splats.logit_opacities > ABSENT_LOGIT)
    np.testing.assert_array_equal(ids, wanted.ids, what)
    for (name, have), (_, want) in zip(store.splats.take(ids).arrays(), wanted.splats.arrays(), strict=True):
        np.testing.assert_array_equal(have, want, f"{what}: {name}")


def played(rng: np.random.Generator, clip: Clip, store: TileStore, last: int) -> None:
    """Messages and ends of frames come in any order while frames up to ``last`` are shown, in time or late."""
    events: list[object] = [*clip.messages(rng), *range(last + 1)]
    rng.shuffle(events)  # type: ignore[arg-type]
    shown = 0
    while events:
        batch = [events.pop() for _ in range(min(len(events), int(rng.integers(1, 8))))]
        assert not store.add_all([event for event in batch if not isinstance(event, int)])  # type: ignore[misc]
        if rng.random() < 0.7:
            assert not store.flush()
        for event in batch:
            if isinstance(event, int):
                store.end(event, NONE)
        if rng.random() < 0.5:
            shown = int(rng.integers(0, last + 1)) if rng.random() < 0.2 else min(shown + 1, last)
            store.commit(shown)
    assert not store.flush()


@settings(max_examples=examples(15), deadline=None)
@given(st.integers(0, 2**32))
def test_any_order_of_arrival_with_jumps_ends_in_what_the_whole_bundle_shows(seed: int) -> None:
    rng = np.random.default_rng(seed)
    of = moving(manifest(frames=10, starts=(0,)))
    with tempfile.TemporaryDirectory() as folder:
        clip = written(Path(folder), of, random_frames(rng, of))
        player, store = BundlePlayer(clip.reader), TileStore(of, clip.reader.codec, threads=1)
        played(rng, clip, store, of.frames - 1)
        for frame in [*range(of.frames), *rng.integers(0, of.frames, 6)]:
            gof, _ = store.commit(int(frame))
            assert_shows(gof, player.frame(int(frame)), f"frame {frame}")
        assert all(tile.lods == (LEVELS if is_motion(clip, tile.frame, tile.tile) else of.lods) for tile in gof.held())


def is_motion(clip: Clip, frame: int, tile: int) -> bool:
    return clip.frames[frame][tile].looks is not None


@settings(max_examples=examples(10), deadline=None)
@given(st.integers(0, 2**32))
def test_groups_of_frames_one_after_another_have_motion_of_their_own(seed: int) -> None:
    rng = np.random.default_rng(seed)
    of = moving(manifest(frames=9, starts=(0, 4)))
    with tempfile.TemporaryDirectory() as folder:
        clip = written(Path(folder), of, random_frames(rng, of))
        player, store = BundlePlayer(clip.reader), TileStore(of, clip.reader.codec, threads=2)
        store.add_all(clip.messages(rng))
        for frame in range(of.frames):
            store.end(frame, NONE)
        for frame in range(of.frames):
            gof, committed = store.commit(frame)
            assert committed.fresh == (frame in of.gof_starts)
            assert_shows(gof, player.frame(frame), f"frame {frame}")


@settings(max_examples=examples(12), deadline=None)
@given(st.integers(0, 2**32))
def test_rows_that_a_commit_does_not_name_have_not_changed(seed: int) -> None:
    rng = np.random.default_rng(seed)
    of = moving(manifest(frames=10, starts=(0,)))
    with tempfile.TemporaryDirectory() as folder:
        clip = written(Path(folder), of, random_frames(rng, of))
        store = TileStore(of, clip.reader.codec)
        for frame in range(of.frames):
            store.end(frame, NONE)
        messages, before = clip.messages(rng), None
        for frame in [*range(of.frames), *range(of.frames)]:
            store.add_all([messages.pop() for _ in range(min(len(messages), 6))])
            gof, committed = store.commit(frame)
            changed = np.union1d(committed.rows, committed.moved)
            assert not np.intersect1d(committed.rows, committed.moved).size
            for at, (name, column) in enumerate(gof.splats.arrays()):
                if before is not None:
                    there = gof.splats.logit_opacities > ABSENT_LOGIT
                    differs = np.flatnonzero((column != before[at]).reshape(len(column), -1).any(axis=1) & there)
                    assert np.isin(differs, changed).all(), name
                    if name in ("log_scales", "sh0"):
                        assert np.isin(differs, committed.rows).all(), name
            before = [column.copy() for _, column in gof.splats.arrays()]
