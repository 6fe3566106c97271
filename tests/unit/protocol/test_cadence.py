"""Which frames are displayed: evenly spread, and the same on both sides."""

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cags_common.errors import ProtocolError
from cags_protocol.cadence import EVERY_FRAME, LEAST_PERMILLE, last_displayed, next_displayed
from cags_protocol.wire.encoding import decode, encode
from cags_protocol.wire.messages import PoseBatch

SHARES = st.integers(LEAST_PERMILLE, EVERY_FRAME)


def displayed(number: int, permille: int) -> bool:
    """As ``docs/wire.md`` has it."""
    return number * permille // 1000 > (number - 1) * permille // 1000


def test_six_in_ten():
    assert [n for n in range(11) if displayed(n, 600)] == [0, 2, 4, 5, 7, 9, 10]


@given(st.integers(0, 10**9), SHARES)
def test_next_and_last_are_what_the_definition_says(number, permille):
    following, before = next_displayed(number, permille), last_displayed(number, permille)
    assert displayed(following, permille)
    assert displayed(before, permille)
    assert not any(displayed(n, permille) for n in range(number, following))
    assert not any(displayed(n, permille) for n in range(before + 1, number + 1))


@given(SHARES, st.integers(0, 10**6))
def test_frames_are_evenly_spread(permille, first):
    shown = [n for n in range(first, first + 100) if displayed(n, permille)]
    assert abs(len(shown) - permille / 10) <= 1
    gaps = {b - a for a, b in pairwise(shown)}
    assert max(gaps) - min(gaps) <= 1


def test_all_frames_cost_no_byte_and_fewer_come_through():
    whole = encode(PoseBatch(()))
    assert b"cadence" not in whole
    assert decode(whole)[0] == PoseBatch(())
    some = PoseBatch((), 600)
    assert decode(encode(some))[0] == some


@pytest.mark.parametrize("permille", [LEAST_PERMILLE - 1, EVERY_FRAME + 1])
def test_other_shares_are_refused(permille):
    with pytest.raises(ProtocolError, match="cadence_permille"):
        encode(PoseBatch((), permille))
