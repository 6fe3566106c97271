"""What splats were a few frames ago: as of any frame that is remembered, and nothing of others."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from cags_client.past import EarlierGroups, SplatPast
from cags_common.splat_buffer import MOVING_COLUMNS
from cags_common.splats import Splats

ROWS = 6


def splats(values: np.ndarray) -> Splats:
    """Splats whose every attribute is ``values`` [N]."""
    column = values.astype(np.float32)[:, None]
    return Splats(
        np.repeat(column, 3, 1), np.repeat(column, 4, 1), np.repeat(column, 3, 1), column[:, 0].copy(),
        np.repeat(column, 3, 1), np.zeros((len(values), 0, 3), np.float32),
    )  # fmt: skip


changes = st.lists(st.tuples(st.sets(st.integers(0, ROWS - 1)), st.booleans()), min_size=1, max_size=12)


@settings(max_examples=100)
@given(changes, st.integers(0, 8))
def test_as_of_gives_back_every_state_that_is_remembered(rows_of: list[tuple[set[int], bool]], span: int) -> None:
    """Rows are replaced whole, or only move."""
    past, held, states = SplatPast(), splats(np.zeros(ROWS)), []
    past.span = span
    for frame, (changed, moved) in enumerate(rows_of, start=1):
        states.append(held.take(slice(None)))
        past.advance(frame)
        rows = np.array(sorted(changed), np.int32)
        past.record(frame, rows, held, moved=moved)
        held = held.take(np.arange(ROWS))
        for name, column in held.arrays():
            if not moved or name in MOVING_COLUMNS:
                column[rows] = frame
    states.append(held)
    last = len(rows_of)
    for frame in range(last + 1):
        assert past.knows(frame) == (frame >= last - span)
        if not past.knows(frame):
            continue
        then = past.as_of(frame, held)
        assert (then is not None) == past.changed_since(frame) == any(changed for changed, _ in rows_of[frame:])
        earlier = EarlierGroups()
        earlier.add(last, held, past)
        for (name, before), (_, whole) in zip(states[frame].arrays(), earlier.as_of(frame).arrays(), strict=True):
            np.testing.assert_array_equal(whole, before, name)
        if then is not None:
            assert not np.intersect1d(then.rows, then.moved).size
            apart = held.take(np.arange(ROWS))
            for name in MOVING_COLUMNS:
                getattr(apart, name)[then.moved] = getattr(then.scene, name)[then.moved]
            for (name, column), (_, old) in zip(apart.arrays(), then.splats.arrays(), strict=True):
                column[then.rows] = old
                np.testing.assert_array_equal(column, getattr(states[frame], name), name)


def test_what_only_moves_within_a_frame_is_remembered_as_it_was_before_and_takes_little() -> None:
    past, held = SplatPast(), splats(np.zeros(ROWS))
    past.span = 10
    rows = np.arange(4)
    for step in range(8):  # on the way to frame 1
        past.record(1, rows, held, moved=True)
        held.means[rows] = step + 1
    assert past._held == 1
    then = past.as_of(0, held)
    assert then is not None
    assert then.moved.tolist() == [0, 1, 2, 3]
    assert not then.scene.means.any()


def test_nothing_is_kept_without_a_span() -> None:
    past = SplatPast()
    past.advance(3)
    past.record(3, np.arange(2, dtype=np.int32), splats(np.zeros(ROWS)))
    assert past.as_of(0, splats(np.zeros(ROWS))) is None
    assert not past.knows(2)
    assert past.knows(3)


def test_what_came_before_the_first_frame_and_before_a_jump_back_is_not_known() -> None:
    past = SplatPast(5)
    past.span = 10
    past.advance(7)
    assert not past.knows(4)
    assert past.knows(5)
    past.record(7, np.arange(2, dtype=np.int32), splats(np.zeros(ROWS)))
    past.restart(6)
    assert not past.knows(5)
    assert not past.changed_since(6)


def test_memory_is_bounded(monkeypatch) -> None:  # type: ignore[no-untyped-def]
    monkeypatch.setattr("cags_client.past.MAX_PAST_SPLATS", 10)
    past = SplatPast()
    past.span = 100
    for frame in range(1, 9):
        past.advance(frame)
        past.record(frame, np.arange(4, dtype=np.int32), splats(np.zeros(ROWS)))
    assert past._held <= 10
    assert past.knows(6)
    assert not past.knows(5)
