"""What a difference and a picture leave between a reference's pixels."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cags_common.geometry import Intrinsics
from cags_server.reference.detail import detail_left, octaves_finer

F = np.float32


def pattern(seed: int, sigma_px: float = 1.0) -> np.ndarray:
    noise = np.random.default_rng(seed).random((64, 96, 3)).astype(F)
    return np.asarray(cv2.GaussianBlur(noise, (0, 0), sigma_px) * F(3) - F(1))


def test_of_splats_that_are_right_nothing_is_left_and_of_wrong_ones_less_by_a_picture() -> None:
    truth = pattern(0)
    good = detail_left(truth, np.zeros_like(truth), 1.0)
    assert good.difference == 0
    assert good.picture == pytest.approx(0, abs=1e-9)
    moved = detail_left(truth, truth - np.roll(truth, 9, axis=1), 1.0)
    assert moved.picture < 0.6 * moved.difference
    missing = detail_left(truth, truth, 1.0)  # the client shows nothing: both leave all of it
    assert missing.picture == pytest.approx(missing.difference)


def test_what_a_display_does_not_show_is_left_by_neither() -> None:
    truth = pattern(0)
    lack = truth - pattern(1)
    one = detail_left(truth, lack, 1.0)
    half = detail_left(truth, lack, 0.5)
    assert half.difference == pytest.approx(one.difference / 2)
    none = detail_left(truth, lack, 0.0)
    assert none.difference == none.picture == 0


@given(st.integers(0, 1000), st.integers(0, 1000))
def test_a_picture_leaves_no_more_detail_than_a_difference(truth: int, own: int) -> None:
    scene = pattern(truth)
    left = detail_left(scene, scene - pattern(own, 1.5), 1.0)
    assert 0 <= left.picture <= left.difference * (1 + 1e-5)


def test_octaves_are_those_of_the_angle_a_pixel_covers() -> None:
    display, reference = Intrinsics.of_fov(800, 600, 1.2, 1.0), Intrinsics.of_fov(400, 300, 1.2, 1.0)
    assert octaves_finer(display, reference) == pytest.approx(1.0)
    wider = Intrinsics.of_fov(400, 300, 1.6, 1.4)
    assert octaves_finer(display, wider) > 1.2
    assert octaves_finer(reference, display) == 0.0
