"""Fades of opacity."""

import numpy as np
import pytest

from cags_common.motion.chunk import FADE_STEP, FADE_WIDTHS
from cags_encoder.motion.fades import WORST_FIT, changing, fit_fades, peaks


def gaussian(centres: np.ndarray, widths: np.ndarray, peak: np.ndarray, frames: int) -> np.ndarray:
    away = (np.arange(frames)[:, None] - centres) / widths
    return peak * np.exp(-0.5 * away * away)


def drawn(fades: np.ndarray, peak: np.ndarray, middles: np.ndarray, frames: int) -> np.ndarray:
    even = np.broadcast_to(peak, (frames, len(peak)))
    width = FADE_WIDTHS[np.maximum(fades[:, 0] - 1, 0)]
    centres = middles + fades[:, 1] * width / FADE_STEP
    return np.where(fades[:, 0] > 0, gaussian(centres, width, peak, frames), even)


def test_gaussians_of_time_are_found_wherever_their_centre_lies() -> None:
    random = np.random.default_rng(0)
    centres, widths = random.uniform(-10, 26, 400), random.uniform(1.5, 12, 400)
    peak = random.uniform(0.3, 0.99, 400)
    true = gaussian(centres, widths, peak, 17)
    present = true > 1 / 255
    some = present.sum(axis=0) > 1
    fades, fits = fit_fades(true, present, peak, np.full(400, 8.0))
    assert fits[some].mean() > 0.95
    error = np.where(present, np.abs(drawn(fades, peak, np.full(400, 8.0), 17) - true), 0.0)
    assert np.percentile(error[:, fits & some], 99) < 0.1


@pytest.mark.parametrize("centre", np.arange(-6.0, 10.1, 0.7))
@pytest.mark.parametrize("frames", [2, 3, 5])
def test_a_few_samples_of_a_gaussian_are_a_fade(centre: float, frames: int) -> None:
    width = np.array([1.1, 1.5, 2.3, 3.6])
    true = gaussian(np.full(4, centre), width, np.full(4, 0.9), frames)
    fades, fits = fit_fades(true, np.ones(true.shape, bool), np.full(4, 0.88), np.full(4, (frames - 1) / 2))
    off = np.sqrt(np.square(drawn(fades, np.full(4, 0.88), np.full(4, (frames - 1) / 2), frames) - true).mean(axis=0))
    assert fits.all() and (off < WORST_FIT).all()


def test_the_last_frame_of_a_life_is_a_fade() -> None:
    true, present = np.full((5, 1), 0.2), np.arange(5)[:, None] == 0
    fades, fits = fit_fades(true, present, np.array([0.8]), np.zeros(1))
    assert fits[0] and drawn(fades, np.array([0.8]), np.zeros(1), 1)[0, 0] == pytest.approx(0.2, abs=0.06)


def test_what_is_even_needs_none_and_what_jumps_is_told_to_fit_nothing() -> None:
    even, jumps = np.full((17, 1), 0.6), np.full((17, 1), 0.9)
    jumps[8:] = 0.1
    both = np.concatenate([even, jumps], axis=1)
    fades, fits = fit_fades(both, np.ones((17, 2), bool), np.array([0.6, 0.9]), np.full(2, 8.0))
    assert fades[0].tolist() == [0, 0] and fits[0]
    assert not fits[1]


def test_a_life_of_one_frame_and_no_life_at_all_stay_finite() -> None:
    opacities, present = np.full((17, 2), 0.5), np.zeros((17, 2), bool)
    present[3, 0] = True
    fades, fits = fit_fades(opacities, present, np.array([0.5, 0.5]), np.zeros(2))
    assert fades.tolist() == [[0, 0], [0, 0]] and fits.all()


@pytest.mark.parametrize("centre", [3.0, 3.4, 8.9])
def test_the_peak_between_two_frames_is_found(centre: float) -> None:
    true = gaussian(np.array([centre]), np.array([2.0]), np.array([0.8]), 17)
    assert peaks(true, np.ones((17, 1), bool))[0] == pytest.approx(0.8, abs=0.01)


def test_no_peak_lies_beyond_opaque() -> None:
    assert peaks(np.array([[0.9], [0.9999], [0.9]]), np.ones((3, 1), bool))[0] < 1.0


def test_an_even_opacity_changes_not_whatever_comes_after_its_end() -> None:
    opacities = np.array([[0.5, 0.5, 0.5], [0.5, 0.6, 0.0], [0.5, 0.5, 0.0]])
    present = np.array([[True, True, True], [True, True, False], [True, True, False]])
    assert changing(opacities, present).tolist() == [False, True, False]
