import pytest

from cags_bench.codec.bjontegaard import bd_psnr_db, bd_rate

ANCHOR = [(100.0, 20.0), (200.0, 25.0), (400.0, 30.0), (800.0, 35.0)]


def test_a_curve_lifted_by_three_db_gains_three() -> None:
    assert bd_psnr_db([(r, q + 3) for r, q in ANCHOR], ANCHOR) == pytest.approx(3.0)


def test_a_curve_at_half_the_bytes_saves_half() -> None:
    assert bd_rate([(r / 2, q) for r, q in ANCHOR], ANCHOR) == pytest.approx(-0.5)


def test_points_that_cost_more_and_show_less_do_not_count() -> None:
    assert bd_psnr_db([*ANCHOR, (300.0, 10.0)], ANCHOR) == pytest.approx(0.0)


def test_curves_without_a_common_range_are_not_compared() -> None:
    assert bd_rate([(1.0, 1.0), (2.0, 2.0)], ANCHOR) is None
