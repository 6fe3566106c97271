"""What differs by no more than coding has left says nothing."""

from __future__ import annotations

import numpy as np
import pytest

from cags_common.correction import Reference, create, trusted
from cags_common.geometry import Camera, Intrinsics, Pose
from cags_common.raster.base import RenderedView

VIEW = Camera(Intrinsics.of_fov(80, 60, 1.3, 1.1), Pose.identity())


def noise(seed: int, *shape: int) -> np.ndarray:
    return np.random.default_rng(seed).normal(0, 0.01, shape).astype(np.float32)


def test_a_picture_says_nothing_where_it_differs_by_no_more_than_coding_has_left() -> None:
    own = np.random.default_rng(0).uniform(0.2, 0.8, (60, 80, 3)).astype(np.float32)
    noisy = own + noise(1, 60, 80, 3)
    noisy[:, 40:] += 0.2  # here something is lacking
    picture = trusted(noisy, own, 0.01**2)
    assert np.abs(picture - own)[:, :30].max() < 0.01, "less than a third of the noise stays"
    assert np.abs(picture - own)[:, :30].std() < 0.003
    assert np.allclose(picture[:, 45:], noisy[:, 45:], atol=0.01)


def test_what_is_close_is_the_own_view_and_what_is_far_the_picture() -> None:
    coded = np.random.default_rng(2).uniform(0.3, 0.6, (60, 80, 3)).astype(np.float32)
    close, far = coded + np.float32(0.01), coded + np.float32(0.3)
    np.testing.assert_allclose(trusted(coded, close, 1e-4), close, atol=1e-6)
    np.testing.assert_allclose(trusted(coded, far, 1e-4), coded, atol=0.001)


def test_a_picture_without_loss_counts_whole() -> None:
    own, truth = np.random.default_rng(1).random((2, 60, 80, 3)).astype(np.float32)
    np.testing.assert_array_equal(trusted(truth, own, 0.0), truth)


@pytest.mark.parametrize("name", ["auto", "reference"])
def test_correctors_trust_a_picture_no_further(name: str) -> None:
    own = np.full((60, 80, 3), 0.5, np.float32)
    picture = own + noise(3, 60, 80, 3)
    view = RenderedView(own, np.ones((60, 80), np.float32), np.full((60, 80), 4.0, np.float32), None)
    left = [
        create(name).correct(view, VIEW, Reference(picture, VIEW, picture=True, error=error), own).rgb - own
        for error in (0.0, 0.01**2)
    ]
    assert left[1].std() < 0.5 * left[0].std()


def test_an_error_beyond_all_colours_is_refused() -> None:
    with pytest.raises(ValueError, match="error = 2"):
        Reference(np.zeros((60, 80, 3), np.float32), VIEW, picture=True, error=2.0)
