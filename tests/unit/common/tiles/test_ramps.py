"""Attributes on their way: every decoder shows the same, whatever comes when."""

from __future__ import annotations

import numpy as np
import pytest

from cags_common.errors import DecodeError
from cags_common.tiles.ramps import LONGEST_RAMP, OF_LOOKS, Ramps, share_of
from cags_common.tiles.updates import RAMP_COLUMNS, UpdateState, encode_update
from support.small_store import ATTRIBUTES, ORDER, books

ONE = np.array([3], np.intp)


def value(of: float) -> np.ndarray:
    return np.full((1, 3), of, np.float32)


def ramps(begin: int = 10, frames: int = 4, since: int = OF_LOOKS) -> Ramps:
    """Splat 3 is on its way from 0 to 1."""
    made = Ramps((3,))
    made.put(ONE, begin, np.array([frames], np.uint8), (value(0), value(1)), np.array([since], np.int32))
    return made


def test_the_first_frame_has_gone_a_part_of_the_way_and_the_last_all_of_it() -> None:
    begin, frames = np.array([10], np.int32), np.array([4], np.uint8)
    assert [float(share_of(time, begin, frames)[0]) for time in (10, 11, 12.5, 13, 20)] == [0.25, 0.5, 0.875, 1, 1]


def test_what_has_arrived_is_forgotten() -> None:
    made = ramps()
    for time, wanted in ((10, 0.25), (12, 0.75), (13, 1.0)):
        ids, values, began = made.at(time)
        assert ids.tolist() == [3] and began.tolist() == [10] and np.all(values == wanted)
    assert len(made) == 0 and made.at(14)[0].tolist() == []


def test_the_last_value_is_reached_to_the_bit() -> None:
    made = Ramps((3,))
    last = np.random.default_rng(1).normal(size=(1, 3)).astype(np.float32)
    made.put(ONE, 0, np.array([3], np.uint8), (value(1e6), last), np.array([OF_LOOKS], np.int32))
    assert np.array_equal(made.at(2)[1], last)


def test_an_earlier_update_that_comes_late_is_where_it_begins() -> None:
    made = ramps(since=5)
    made.precede(ONE, 4, value(9))
    assert np.all(made.at(10)[1] == 0.25), "a newer one was known"
    made.precede(ONE, 7, value(0.5))
    assert np.all(made.at(11)[1] == 0.75)
    made.precede(ONE, 10, value(7))
    assert np.all(made.at(11)[1] == 0.75), "one of its own frame does not come before it"
    assert made.follows(ONE, 7) and not made.follows(ONE, 5)


def test_looks_that_come_later_are_where_it_begins_unless_an_update_is_newer() -> None:
    made = ramps(since=5)
    made.stand_on(ONE, 5, value(0.5))
    assert np.all(made.at(10)[1] == 0.25)
    made.stand_on(ONE, 6, value(0.5))
    assert np.all(made.at(11)[1] == 0.75)


def test_its_own_update_refines_its_end_and_another_one_takes_over_from_there() -> None:
    made = ramps()
    pair, looks = np.array([2, 3]), np.full(2, OF_LOOKS, np.int32)
    last = np.concatenate([value(5), value(2)])
    made.take_over(pair, 10, np.full(2, 4, np.uint8), (np.concatenate([value(7), value(7)]), last), looks)
    assert np.all(made.ends(ONE, value(0)) == 2) and np.all(made.ends(ONE + 1, value(0)) == 0)
    ids, values, _ = made.at(10)
    assert dict(zip(ids.tolist(), values[:, 0].tolist(), strict=True)) == {2: 6.5, 3: 0.5}, "from what is shown"
    made.take_over(ONE, 12, np.array([2], np.uint8), (value(7), value(4)), np.array([10], np.int32))
    ids, values, _ = made.at(12)
    assert len(made) == 2 and dict(zip(ids.tolist(), values[:, 0].tolist(), strict=True))[3] == 3


def update_of(frames: list[int]) -> bytes:
    n = len(frames)
    masks = {name: np.full(n, name == "sh0") for name in ATTRIBUTES}
    codes = {name: np.zeros(n, np.uint32) for name in ATTRIBUTES}
    lengths = {"sh0": np.array(frames, np.int64).astype(np.uint8)}
    return encode_update(np.arange(n, dtype=np.int32), masks, codes, books(), ORDER, lengths)[0]


def test_an_update_says_how_long_each_ramp_is_and_nothing_where_none_is() -> None:
    told = UpdateState(update_of([1, 16, 7]), books(), ORDER).values()["sh0"]
    assert told.frames.tolist() == [1, 16, 7]
    assert UpdateState(update_of([1, 1, 1]), books(), ORDER).values()["sh0"].frames.tolist() == [1, 1, 1]
    assert len(update_of([1, 1, 1])) < len(update_of([1, 16, 7]))
    assert "logit_opacities" not in RAMP_COLUMNS


def test_ramps_that_are_too_long_are_refused() -> None:
    with pytest.raises(DecodeError, match=f"a ramp of {LONGEST_RAMP + 1} frames; {LONGEST_RAMP} are the most"):
        UpdateState(update_of([1, LONGEST_RAMP + 1]), books(), ORDER)
