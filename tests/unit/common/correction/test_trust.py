"""How far a picture is believed, and how far the client's own colours give way to it."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cags_common.correction import Reference, create, layer
from cags_common.correction.trust import MOST_DOUBTED, doubted
from cags_common.geometry import Camera, Intrinsics, Pose
from cags_common.raster.base import RenderedView

F = np.float32
VIEW = Camera(Intrinsics.of_fov(80, 60, 1.3, 1.1), Pose.identity())


def noise(seed: int, *shape: int) -> np.ndarray:
    return np.random.default_rng(seed).normal(0, 0.01, shape).astype(F)


def colours(seed: int, low: float = 0.2, high: float = 0.8) -> np.ndarray:
    return np.random.default_rng(seed).uniform(low, high, (60, 80, 3)).astype(F)


def laid_over(own: np.ndarray, over: np.ndarray) -> np.ndarray:
    return own * (1 - over[..., 3:]) + over[..., :3]


def power(image: np.ndarray) -> float:
    return float(np.mean(np.square(image)))


def test_a_picture_says_nothing_where_it_differs_by_no_more_than_coding_has_left() -> None:
    own = colours(0, 0.2, 0.7)
    noisy = own + noise(1, 60, 80, 3)
    noisy[:, 40:] += 0.2  # here something is lacking
    over = layer(noisy, own, 0.01**2)
    assert np.abs(laid_over(own, over) - own)[:, :30].max() < 0.01, "less than a third of the noise stays"
    assert (laid_over(own, over) - own)[:, :30].std() < 0.003
    assert np.allclose(laid_over(own, over)[:, 45:], noisy[:, 45:], atol=0.01)


@given(st.floats(0, 1), st.floats(0, 1))
def test_a_picture_is_doubted_only_where_the_splats_are_better(error: float, own_error: float) -> None:
    taken = doubted(error, own_error)
    assert error <= taken <= max(error, MOST_DOUBTED)
    assert taken == error or own_error < error
    assert taken >= doubted(error, min(1.0, 2 * own_error)), "less for worse splats"
    assert doubted(error, math.nan) == error


def test_a_doubted_picture_takes_nothing_from_good_splats_whose_scene_has_moved_on() -> None:
    own = colours(0, 0.2, 0.7)
    old = own + noise(1, 60, 80, 3)
    old[:, :10] += F(0.06)  # coding errors are larger here, and smaller there
    old[:, 60:] = np.roll(own, 3, axis=1)[:, 60:]  # there it moves
    error = power((old - own)[:, :50])
    by_itself, told = layer(old, own, error), layer(old, own, doubted(error, 1e-6))
    left = [power((laid_over(own, over) - own)[:, :50]) for over in (by_itself, told)]
    assert left[0] > 1e-5
    assert left[1] < 1e-7
    old[:30, :30] = 1.0  # nothing was there of the splats: own is far from it
    dark = own.copy()
    dark[:30, :30] = 0.0
    filled = laid_over(dark, layer(old, dark, doubted(error, 1e-6)))
    assert filled[5:25, 5:25].min() > 0.9


def test_what_is_close_is_the_own_view_and_what_is_far_the_picture() -> None:
    coded = colours(2, 0.3, 0.6)
    close, far = coded + F(0.01), coded + F(0.3)
    np.testing.assert_allclose(laid_over(close, layer(coded, close, 1e-4)), close, atol=1e-6)
    np.testing.assert_allclose(laid_over(far, layer(coded, far, 1e-4)), coded, atol=0.001)


def test_a_picture_without_loss_counts_whole() -> None:
    own, truth = np.random.default_rng(1).random((2, 60, 80, 3)).astype(F)
    np.testing.assert_allclose(laid_over(own, layer(truth, own, 0.0)), truth, atol=1e-6)


def test_a_picture_that_is_poorer_than_the_view_says_nothing() -> None:
    """Coding leaves most where there is most detail: there, too, what it left is no lack of the client's."""
    truth = colours(3)
    own = truth + 0.1 * noise(4, 60, 80, 3)
    flaws = noise(5, 60, 80, 3)
    flaws[:, :8] *= 5
    coded = np.clip(truth + flaws, 0, 1)
    shown = laid_over(own, layer(coded, own, power(coded - truth)))
    assert power(shown - truth) < 1.01 * power(own - truth)


def test_an_object_that_is_missing_from_a_good_view_comes_from_the_picture() -> None:
    truth = colours(3, 0.4, 0.6)
    own = truth + 0.1 * noise(4, 60, 80, 3)
    own[20:30, 20:30] = 0.0
    coded = truth + noise(5, 60, 80, 3)
    shown = laid_over(own, layer(coded, own, 0.01**2))
    np.testing.assert_allclose(shown[24:26, 24:26], coded[24:26, 24:26], atol=0.01)


def test_detail_that_is_the_pictures_is_kept_and_detail_that_is_not_gives_way() -> None:
    own = colours(6)
    darker = own * F(0.7)
    kept = layer(darker, own, 1e-6)[..., 3]
    assert kept.max() < 0.35, "of the same detail, seven tenths"
    other = layer(colours(7), own, 1e-6)[..., 3]
    assert other.mean() > 0.9
    flat = np.full_like(own, 0.3)
    assert layer(colours(8), flat, 1e-6)[..., 3].max() < 0.01, "what has no detail has none to give way"


def test_splats_that_stand_where_they_were_do_not_show_at_the_displays_size() -> None:
    """A pattern that has moved: between the reference's pixels the client's own detail is of the old place."""
    size = 320, 240
    pattern = cv2.GaussianBlur(np.random.default_rng(9).random((240, 340, 3)).astype(F), (0, 0), 1.5)
    pattern = (pattern - pattern.mean()) * 4 + F(0.5)
    own, truth = pattern[:, :320], pattern[:, 11:331]
    view = Camera(Intrinsics.of_fov(*size, 1.3, 1.1), Pose.identity())
    small = [cv2.resize(image, (80, 60), interpolation=cv2.INTER_AREA) for image in (own, truth)]
    drawn = RenderedView(own.clip(0, 1), np.ones((240, 320), F), np.full((240, 320), 4.0, F), None)
    reference = Reference(small[1].clip(0, 1), VIEW, picture=True)
    shown = create("oracle").correct(drawn, view, reference, small[0].clip(0, 1)).rgb
    added = own + cv2.resize(small[1] - small[0], size, interpolation=cv2.INTER_LINEAR)
    inside = np.s_[16:-16, 16:-16]
    assert power((shown - truth.clip(0, 1))[inside]) < 0.7 * power((added - truth)[inside])


@given(st.integers(0, 2**32 - 1), st.floats(0, 1), st.sampled_from([(1, 1), (1, 9), (5, 7), (23, 17)]))
def test_a_layer_is_one_whatever_the_colours(seed: int, error: float, size: tuple[int, int]) -> None:
    rng = np.random.default_rng(seed)
    coded, own = (rng.normal(0.5, rng.choice([0, 1e-4, 0.3, 10]), (*size, 3)).astype(F) for _ in range(2))
    over = layer(coded, own, error)
    assert over.shape == (*size, 4) and over.dtype == F
    assert np.isfinite(over).all()
    assert (over[..., 3] >= 0).all() and (over[..., 3] <= 1).all()
    assert (np.abs(over[..., :3]) <= 1).all()
    shown = laid_over(own.clip(0, 1), over)
    assert shown.min() >= -1e-6 and shown.max() <= 1 + 1e-6


@pytest.mark.parametrize("name", ["auto", "oracle"])
def test_correctors_trust_a_picture_no_further(name: str) -> None:
    own = np.full((60, 80, 3), 0.5, F)
    picture = own + noise(3, 60, 80, 3)
    view = RenderedView(own, np.ones((60, 80), F), np.full((60, 80), 4.0, F), None)
    left = [
        create(name).correct(view, VIEW, Reference(picture, VIEW, picture=True, error=error), own).rgb - own
        for error in (0.0, 0.01**2)
    ]
    assert left[1].std() < 0.5 * left[0].std()


def test_an_error_beyond_all_colours_is_refused() -> None:
    with pytest.raises(ValueError, match="error = 2"):
        Reference(np.zeros((60, 80, 3), F), VIEW, picture=True, error=2.0)
