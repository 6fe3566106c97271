"""What splats were a few frames ago: as of any frame that is remembered, and nothing of others."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from cags_client.past import SplatPast
from cags_common.splats import Splats

ROWS = 6


def splats(values: np.ndarray) -> Splats:
    """Splats whose every attribute is ``values`` [N]."""
    column = values.astype(np.float32)[:, None]
    return Splats(
        np.repeat(column, 3, 1), np.repeat(column, 4, 1), np.repeat(column, 3, 1), column[:, 0].copy(),
        np.repeat(column, 3, 1), np.zeros((len(values), 0, 3), np.float32),
    )  # fmt: skip


changes = st.lists(st.sets(st.integers(0, ROWS - 1)), min_size=1, max_size=12)


@settings(max_examples=60)
@given(changes, st.integers(0, 8))
def test_as_of_gives_back_every_state_that_is_remembered(rows_of: list[set[int]], span: int) -> None:
    past, held, states = SplatPast(), np.zeros(ROWS), []
    past.span = span
    for frame, changed in enumerate(rows_of, start=1):
        states.append(held.copy())
        past.advance(frame)
        rows = np.array(sorted(changed), np.int32)
        past.record(frame, rows, splats(held))
        held[rows] = frame
    states.append(held.copy())
    last = len(rows_of)
    for frame in range(last + 1):
        assert past.knows(frame) == (frame >= last - span)
        if past.knows(frame):
            then = held.copy()
            before = past.as_of(frame)
            assert (before is not None) == past.changed_since(frame) == any(rows_of[frame:])
            if before is not None:
                then[before[0]] = before[1].means[:, 0]
            np.testing.assert_array_equal(then, states[frame])


def test_nothing_is_kept_without_a_span() -> None:
    past = SplatPast()
    past.advance(3)
    past.record(3, np.arange(2, dtype=np.int32), splats(np.zeros(ROWS)))
    assert past.as_of(0) is None
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
