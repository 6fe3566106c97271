import logging

from cags_common.runtime import rare_log
from cags_common.runtime.rare_log import RareFilter, RareLog


def test_one_line_a_key_and_second_with_a_count_of_the_others(caplog):
    now = [0.0]
    told = RareLog(logging.getLogger("rare"), clock=lambda: now[0])
    for _ in range(1000):
        told.write(logging.WARNING, "a", "%s knocks", "a")
    told.write(logging.WARNING, "b", "%s knocks", "b")
    now[0] = 1.0
    told.write(logging.WARNING, "a", "%s knocks", "a")
    assert [record.getMessage() for record in caplog.records] == [
        "a knocks",
        "b knocks",
        "a knocks (999 more like this were not logged)",
    ]


def test_offenders_without_number_take_no_memory_without_end(caplog, monkeypatch):
    monkeypatch.setattr(rare_log, "MAX_KEYS", 8)
    told = RareLog(logging.getLogger("rare"))
    for number in range(100):
        told.write(logging.WARNING, number, "x")
    assert len(told._allowance._told) == 8


def test_a_few_lines_may_come_at_once(caplog):
    told = RareLog(logging.getLogger("rare"), burst=3, clock=lambda: 0.0)
    assert [told.write(logging.WARNING, "a", "x") for _ in range(5)] == [True, True, True, False, False]


def test_what_other_packages_repeat_is_held_back(caplog):
    now = [0.0]
    held = RareFilter(clock=lambda: now[0])
    theirs, ours = (logging.LogRecord(n, logging.ERROR, "x.py", 7, "%d%% lost", (1,), None) for n in ("aio", "cags_x"))
    assert sum(held.filter(theirs) for _ in range(100)) == 5
    assert sum(held.filter(ours) for _ in range(100)) == 100
    now[0] = 1.0
    again = logging.LogRecord("aio", logging.ERROR, "x.py", 7, "%d%% lost", (1,), None)
    assert held.filter(again)
    assert again.getMessage() == "1% lost (95 more like this were not logged)"
