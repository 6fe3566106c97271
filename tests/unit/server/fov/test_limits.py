"""Which views a reference can be drawn for."""

from __future__ import annotations

import math

import pytest

from cags_common.geometry import Intrinsics
from cags_server.fov.limits import undrawable


def view(width: int, height: int, degrees: float) -> Intrinsics:
    return Intrinsics.of_fov(width, height, math.radians(degrees), math.radians(degrees))


@pytest.mark.parametrize("degrees", [0.6, 60.0, 178.5])
def test_ordinary_views_are_drawn(degrees: float) -> None:
    assert undrawable(view(640, 480, degrees), full_size=True) is None


def test_a_view_that_is_too_narrow_is_refused_with_both_figures() -> None:
    assert undrawable(view(640, 480, 0.4), full_size=False) == "the view spans 0.4 degrees; at least 0.5 are drawn"


def test_an_off_centre_view_counts_by_its_wider_half() -> None:
    aside = Intrinsics(100, 100, 0.5, 50.0, 0.0, 50.0)  # all of it to one side: 2 atan(200)
    assert "a pinhole camera draws 179 at most" in (undrawable(aside, full_size=False) or "")


def test_size_counts_only_for_references_of_the_clients_size() -> None:
    large = view(8000, 8000, 60.0)
    assert undrawable(large, full_size=False) is None
    assert "pictures of 8000x8000 cannot be coded" in (undrawable(large, full_size=True) or "")
    assert undrawable(view(1, 1, 60.0), full_size=True) is not None
