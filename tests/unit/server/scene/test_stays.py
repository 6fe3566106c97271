"""For how long what is there stays: the same from the frame before as looked up anew, and as defined."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from cags_server.scene.ownership import Owners
from cags_server.scene.stays import LOOK_AHEAD, UNCHANGED, Changes, Stays


def group(seed: int, frames: int, *, quiet: float, updates: bool) -> list[Owners]:
    """Owners of a group in which splats come, go and change; quiet frames share the arrays of the one before."""
    rng = np.random.default_rng(seed)
    looks = rng.integers(-1, 3, 40).astype(np.int32)
    more = np.full((4, 40), -1, np.int32)
    out = []
    for frame in range(frames):
        if rng.random() > quiet:
            looks = looks.copy()
            looks[rng.random(40) < 0.1] = 3 + frame
            looks[rng.random(40) < 0.03] = -1
        if rng.random() > quiet:
            more = more.copy()
            more[rng.random((4, 40)) < 0.05] = 3 + frame
        out.append(Owners(looks, more if updates else None, None))
    return out


def as_defined(arrays: list[NDArray[np.int32]]) -> NDArray[np.uint8]:
    out = np.full(arrays[0].shape, UNCHANGED, np.uint8)
    for place in np.ndindex(out.shape):
        differs = [after for after, array in enumerate(arrays) if array[place] != arrays[0][place]]
        out[place] = differs[0] if differs else UNCHANGED
    return out


@given(st.integers(0, 10_000), st.integers(1, 2 * LOOK_AHEAD + 4), st.sampled_from([0.0, 0.5, 0.9]), st.booleans())
def test_changes_follow_from_those_of_the_frame_before(seed: int, frames: int, quiet: float, updates: bool) -> None:
    owners = group(seed, frames, quiet=quiet, updates=updates)
    before = None
    for frame in range(frames):
        ahead = owners[frame : frame + LOOK_AHEAD + 1]
        before = Changes.of(ahead, before)
        np.testing.assert_array_equal(before.looks, as_defined([each.looks for each in ahead]))
        assert (before.updates is None) == (not updates)
        if before.updates is not None:
            found = [each.updates for each in ahead if each.updates is not None]
            np.testing.assert_array_equal(before.updates, as_defined(found))


def test_what_outlives_the_look_ahead_goes_on_to_go_at_its_tiles_rate() -> None:
    looks = np.repeat(np.arange(2, dtype=np.int32), 10)
    changes = np.full(20, UNCHANGED, np.uint8)
    changes[:5] = 3  # half of the first tile goes within 8 frames, so the rest is given 16
    stays = Stays.of(Changes(changes, None), looks, frame=0, end=39)
    assert stays.looks.tolist() == [3] * 5 + [2 * LOOK_AHEAD] * 5 + [40] * 10


@pytest.mark.parametrize(("end", "most"), [(4, 5), (200, 60)])
def test_nothing_stays_beyond_its_group_or_for_ever(end: int, most: int) -> None:
    changes = Changes(np.full(4, UNCHANGED, np.uint8), np.full((4, 4), UNCHANGED, np.uint8))
    stays = Stays.of(changes, np.array([0, 0, -1, 1], np.int32), frame=0, end=end)
    assert stays.updates is not None
    assert set(stays.looks.tolist()) == set(stays.updates.ravel().tolist()) == {most}
