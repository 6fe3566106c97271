"""Bounded by bytes, the longest unused goes first."""

from hypothesis import given
from hypothesis import strategies as st

from cags_common.runtime.recent import Recent


def test_the_longest_unused_goes_first():
    kept = Recent[str, int](30)
    for name in "abc":
        kept.put(name, ord(name), 10)
    assert kept.get("a") == ord("a")
    kept.put("d", 4, 10)
    assert list(kept) == ["c", "a", "d"]
    assert kept.get("b") is None


def test_the_least_stay_however_large():
    kept = Recent[int, bytes](10, least=2)
    for key in range(3):
        kept.put(key, bytes(100), 100)
    assert list(kept) == [1, 2]


def test_a_value_put_again_counts_once():
    kept = Recent[int, str](100)
    kept.put(1, "old", 60)
    kept.put(1, "new", 70)
    assert (kept.get(1), kept.bytes, len(kept)) == ("new", 70, 1)
    kept.clear()
    assert (kept.get(1), kept.bytes, len(kept)) == (None, 0, 0)


@given(st.lists(st.tuples(st.integers(0, 9), st.integers(0, 50))), st.integers(0, 100), st.integers(1, 3))
def test_bytes_are_those_of_what_is_kept_and_within_the_bound(puts, most, least):
    kept = Recent[int, int](most, least=least)
    for key, size in puts:
        kept.put(key, size, size)
        assert kept.get(key) == size
        assert kept.bytes == sum(kept.get(k) or 0 for k in list(kept))
        assert kept.bytes <= most or len(kept) <= least
