"""When a client's references come late so often that nothing is compared for it."""

from __future__ import annotations

from cags_server.reference.lateness import PATIENCE, Lateness


def after(lateness: Lateness, count: int, *, late: bool) -> bool:
    for _ in range(count):
        lateness.observe(late=late)
    return lateness.often


def test_one_late_reference_changes_nothing_and_many_do() -> None:
    lateness = Lateness()
    assert not after(lateness, 2, late=True)
    assert not after(lateness, 20, late=False)
    assert after(lateness, 8, late=True)


def test_comparisons_begin_again_after_a_while_in_time() -> None:
    lateness = Lateness()
    after(lateness, 10, late=True)
    assert after(lateness, PATIENCE - 1, late=False)
    assert not after(lateness, 1, late=False)


def test_a_machine_at_the_edge_does_not_go_to_and_fro() -> None:
    lateness, changes, often = Lateness(), 0, False
    for _ in range(3000):
        lateness.observe(late=not lateness.often)  # in time while nothing is compared, and late while it is
        changes += lateness.often is not often
        often = lateness.often
    assert changes <= 14
