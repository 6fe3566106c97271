"""Smoothing removes noise of the source but not motion."""

from __future__ import annotations

import numpy as np
import pytest

from cags_encoder.motion.smoothing import LEAST_FRAMES, SHARE, smoothed

FRAMES, SPLATS, MOST = 17, 50, 3.0
TIMES = np.arange(FRAMES)[:, None, None]
EVEN: np.ndarray = np.linspace(-3, 3, SPLATS)[None, :, None] * TIMES * np.ones(4) + 0.02 * TIMES**2


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.square(values).mean()))


@pytest.mark.parametrize("size", [0.1, 0.5])
def test_noise_of_even_turns_goes(size: float) -> None:
    noisy = EVEN + np.random.default_rng(1).normal(0, size, EVEN.shape)
    found = smoothed(noisy, MOST, starts=True)
    assert rms(found - noisy) < 1.2 * SHARE * size
    assert rms(found - EVEN) < rms(noisy - EVEN)
    assert rms(np.diff(found, 2, axis=0)) < 0.25 * rms(np.diff(noisy, 2, axis=0))


def test_no_sample_changes_by_more_than_is_seen() -> None:
    wild = np.random.default_rng(2).normal(0, 500, EVEN.shape)
    assert np.abs(smoothed(wild, MOST, starts=True) - wild).max() <= MOST


def test_what_is_smooth_stays() -> None:
    assert np.array_equal(smoothed(EVEN, MOST, starts=True), EVEN)


def test_the_first_sample_stays_nothing_where_nothing_tells_it() -> None:
    noisy = EVEN + np.random.default_rng(3).normal(0, 0.5, EVEN.shape)
    noisy[0] = 0
    assert np.abs(smoothed(noisy, MOST, starts=False)[0]).max() < 1e-3


@pytest.mark.parametrize("frames", range(1, LEAST_FRAMES))
def test_a_few_samples_are_left_alone(frames: int) -> None:
    noisy = np.random.default_rng(4).normal(0, 1, (frames, 3, 4))
    assert np.array_equal(smoothed(noisy, MOST, starts=True), noisy)
    assert smoothed(noisy[:, :0], MOST, starts=True).shape == (frames, 0, 4)


def test_no_splats_at_all() -> None:
    assert smoothed(np.zeros((FRAMES, 0, 4)), MOST, starts=True).shape == (FRAMES, 0, 4)
