"""Words of messages."""

from cags_common.words import counted


def test_one_is_singular() -> None:
    assert [counted(number, "stall") for number in (0, 1, 2)] == ["0 stalls", "1 stall", "2 stalls"]
