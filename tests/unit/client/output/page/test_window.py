"""What is drawn for a page's window."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cags_client.output.page.window import windowed
from cags_client.settings import ClientSettings

SIDES = st.integers(1, 8192)
SETTINGS = st.builds(
    ClientSettings, width=st.integers(64, 4096), height=st.integers(64, 4096), fov=st.floats(20.0, 100.0)
)


def tans(width: int, height: int, fov: float) -> tuple[float, float]:
    """Of half the angles across and down."""
    across = math.tan(math.radians(fov) / 2)
    return across, across * height / width


@given(SETTINGS, SIDES, SIDES)
def test_a_picture_has_the_windows_shape_and_no_more_pixels_than_are_allowed_or_shown(
    settings: ClientSettings, width: int, height: int
) -> None:
    w, h, _ = windowed(settings, width, height)
    assert w % 2 == h % 2 == 0
    assert w * h <= max(settings.width * settings.height, 16 * max(w, h))
    assert w <= max(width, 16)
    assert h <= max(height, 16)
    aspect = min(max(width / height, 0.25), 4.0)
    if min(w, h) > 16:
        assert (w - 2) / (h + 2) <= aspect <= (w + 2) / (h - 2)
        most = min(width * height, settings.width * settings.height)
        assert 0.25 < aspect < 4.0 or w * h <= most
        assert not 0.25 < aspect < 4.0 or (w + 2) * (h + 2) >= most


@given(SETTINGS, SIDES, SIDES)
def test_as_much_is_seen_as_was_asked_for_unless_it_would_take_a_right_angle(
    settings: ClientSettings, width: int, height: int
) -> None:
    w, h, fov = windowed(settings, width, height)
    asked, seen = tans(settings.width, settings.height, settings.fov), tans(w, h, fov)
    whole = all(mine >= theirs - 1e-9 for mine, theirs in zip(seen, asked, strict=True))
    assert whole or max(seen) == pytest.approx(max(1.0, *asked))
    assert any(mine <= theirs + 1e-9 for mine, theirs in zip(seen, asked, strict=True)), "and no more than that"


def test_windows_that_people_have() -> None:
    settings = ClientSettings(width=1280, height=960, fov=60.0)
    assert windowed(settings, 1280, 960) == (1280, 960, pytest.approx(60.0))
    assert windowed(settings, 640, 480) == (640, 480, pytest.approx(60.0))
    wide = windowed(settings, 1920, 1080)
    assert wide[:2] == (1478, 830)
    assert tans(*wide)[1] >= tans(1280, 960, 60.0)[1], "heads are not cut off"
    tall = windowed(settings, 780, 1688)
    assert tall[:2] == (752, 1630)
    assert tans(*tall)[1] == pytest.approx(1.0)
