import logging

from cags_common import rare_log
from cags_common.rare_log import RareLog


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
    assert len(told._told) == 8
