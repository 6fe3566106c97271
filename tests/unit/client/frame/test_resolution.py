"""Frames that are worked out at half the pixels a side: what they keep, and when the client chooses them."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import cags_kernels
from cags_client.frame.resolution import AUTO, DOWN_AFTER_S, FULL, HALF, UP_AFTER_S, Resolutions, Tier, TierController
from cags_common.geometry import Camera, Intrinsics, Pose
from cags_common.raster.halving import enlarged, halved

FRAME_MS = 1000 / 30


def display(width: int, height: int) -> Camera:
    return Camera(Intrinsics.of_fov(width, height, 1.0, 0.8), Pose.identity(), 0.1)


class Machine:
    """A client whose pixels take their time."""

    def __init__(self, full_ms: float, rest_ms: float = 5.0, half_share: float = 0.4) -> None:
        self.resolutions = Resolutions(FRAME_MS)
        self.full_ms, self.rest_ms, self.half_share = full_ms, rest_ms, half_share
        self.now_s = 0.0

    def play(self, seconds: float) -> list[str]:
        """The resolution of every frame."""
        out, end_s = [], self.now_s + seconds
        while self.now_s < end_s:
            chosen = self.resolutions.chosen(AUTO)
            out.append(chosen)
            pixels_ms = self.full_ms * (1.0 if chosen == FULL else self.half_share)
            frame_ms = pixels_ms + self.rest_ms
            self.now_s += max(frame_ms, FRAME_MS) / 1e3
            self.resolutions.observe(self.now_s, {"raster": pixels_ms / 2, "correct": pixels_ms / 2}, frame_ms)
        return out


def test_a_wish_is_followed_and_auto_begins_with_the_whole():
    assert [Resolutions(FRAME_MS).chosen(wish) for wish in (FULL, HALF, AUTO)] == [FULL, HALF, FULL]


def test_auto_keeps_to_the_whole_where_it_fits():
    assert set(Machine(full_ms=20.0).play(20)) == {FULL}


def test_auto_halves_what_takes_too_long_soon_and_stays_there():
    chosen = Machine(full_ms=54.0).play(60)
    assert chosen.index(HALF) <= 12
    assert set(chosen[chosen.index(HALF) :]) == {HALF}


def test_auto_comes_back_when_the_load_is_gone_and_not_before():
    machine = Machine(full_ms=54.0)
    machine.play(5)
    machine.full_ms = 15.0
    chosen = machine.play(4 * UP_AFTER_S)
    back = chosen.index(FULL)
    assert back >= UP_AFTER_S * 30 - 1
    assert set(chosen[back:]) == {FULL}


@pytest.mark.parametrize("full_ms", [24.0, 26.0, 28.0, 29.0, 31.0, 40.0])
@pytest.mark.parametrize("half_share", [0.3, 0.4, 0.6])
def test_auto_does_not_flicker_at_the_edge(full_ms, half_share):
    """A machine that is told wrong of what half saves tries the whole ever more seldom."""
    chosen = Machine(full_ms, half_share=half_share).play(60)
    changes = sum(a != b for a, b in pairwise(chosen))
    assert changes <= 12
    late = len(chosen) // 2
    assert sum(a != b for a, b in pairwise(chosen[late:])) <= 4
    assert DOWN_AFTER_S < UP_AFTER_S


TIERS = (Tier("low", 0.0), Tier("middle", 5.0), Tier("high", 15.0), Tier("highest", 400.0))


@pytest.mark.parametrize(("rest_ms", "name"), [(8, "high"), (20, "middle"), (200, "low")])
def test_the_dearest_tier_that_fits_is_picked_at_the_start(rest_ms, name):
    assert TierController(TIERS, FRAME_MS, rest_ms).name == name


def test_one_slow_frame_changes_nothing():
    controller = TierController(TIERS, FRAME_MS, 8.0)
    for i in range(60):
        controller.observe(i / 30, 15.0, 120.0 if i == 30 else 23.0)
        assert controller.name == "high"


def test_frames_of_which_nothing_is_known_do_not_change_the_tier():
    controller = TierController(TIERS, FRAME_MS, 20.0)
    for i in range(300):
        controller.observe(i / 30, None, 20.0)
    assert controller.name == "middle"


@given(st.lists(st.tuples(st.floats(0, 1), st.none() | st.floats(0, 1e4), st.floats(0, 1e4)), max_size=60))
def test_whatever_is_observed_the_tier_is_one_of_them_and_moves_by_one(observed):
    controller, now_s = TierController(TIERS, FRAME_MS), 0.0
    places = {tier.name: i for i, tier in enumerate(TIERS)}
    before = places[controller.name]
    for step_s, pixels_ms, frame_ms in observed:
        now_s += step_s
        place = places[controller.observe(now_s, pixels_ms, frame_ms)]
        assert abs(place - before) <= 1
        before = place


def test_no_tiers_are_refused():
    with pytest.raises(ValueError, match="nothing to choose from"):
        TierController((), FRAME_MS)


@pytest.mark.parametrize("native", [True, False])
@pytest.mark.parametrize("size", [(64, 48), (63, 47), (1, 1), (2, 1), (1, 7)])
def test_pictures_come_up_to_any_size_in_range(size, native, monkeypatch):
    monkeypatch.setattr(cags_kernels, "native_available", lambda: native and cags_kernels.library.native_available())
    camera = display(*size)
    small = halved(camera)
    rng = np.random.default_rng(0)
    picture = np.float32(rng.random((small.height_px, small.width_px, 3)) > 0.5)  # nothing but edges
    whole = enlarged(picture, camera, 2)
    assert whole.shape == (camera.height_px, camera.width_px, 3)
    assert whole.min() >= 0
    assert whole.max() <= 1
    flat = np.full_like(picture, 0.625)
    np.testing.assert_allclose(enlarged(flat, camera, 1), 0.625, atol=1e-6)


@pytest.mark.skipif(not cags_kernels.native_available(), reason=cags_kernels.why_unavailable())
@pytest.mark.parametrize("size", [(64, 48), (61, 35)])
def test_the_kernel_brings_up_as_opencv_does(size, monkeypatch):
    camera = display(*size)
    small = halved(camera)
    picture = np.random.default_rng(1).random((small.height_px, small.width_px, 3), dtype=np.float32)
    fast = enlarged(picture, camera, 3)
    monkeypatch.setattr(cags_kernels, "native_available", lambda: False)
    np.testing.assert_allclose(fast, enlarged(picture, camera, 1), atol=1e-5)


@pytest.mark.parametrize("native", [True, False])
def test_a_picture_of_another_size_is_refused(native, monkeypatch):
    monkeypatch.setattr(cags_kernels, "native_available", lambda: native and cags_kernels.library.native_available())
    with pytest.raises(ValueError, match="is not half of 9x9 px"):
        enlarged(np.zeros((4, 5, 3), np.float32), display(9, 9), 1)


def test_a_ramp_lies_where_it_lay():
    """Half-pixel centres: column j of the half picture lies between columns 2 j and 2 j + 1, to a tenth of a pixel."""
    camera = display(32, 8)
    ramp = np.broadcast_to((np.arange(16, dtype=np.float32)[None, :, None] * 2 + 1) / 32, (4, 16, 3))
    whole = enlarged(np.ascontiguousarray(ramp), camera, 1)
    np.testing.assert_allclose(whole[4, 4:-4, 0], (np.arange(32)[4:-4] + 0.5) / 32, atol=0.1 / 32)
