"""The training subset for codebooks: splats of the first frame, and those that change later."""

from __future__ import annotations

import numpy as np
import pytest

from cags_common.errors import SceneError
from cags_common.splats import Splats
from cags_encoder.sampling import FRAMES, looked_at, training_splats
from support.raster_scenes import random_splats


def rows_of(some: Splats, of: Splats) -> np.ndarray:
    """Whether each splat of ``some`` is one of ``of``."""
    return np.isin(some.logit_opacities, of.logit_opacities)


@pytest.mark.parametrize("frames", [1, 2, FRAMES, FRAMES + 1, 1000])
def test_frames_are_spread_over_the_clip(frames: int) -> None:
    looks = looked_at(frames)
    assert looks[0] == 0 and looks[-1] == frames - 1
    assert looks == sorted(set(looks)) and len(looks) == min(frames, FRAMES)


def test_half_of_the_subset_comes_from_what_changed() -> None:
    first, fresh = random_splats(100, seed=1), random_splats(100, seed=2)
    clip = [(0, first), (1, Splats.concatenate([first, fresh]))]
    chosen = training_splats("clip", 2, clip, 60, seed=3)
    assert len(chosen) == 60
    assert rows_of(chosen, first).sum() == 30 and rows_of(chosen, fresh).sum() == 30
    again = training_splats("clip", 2, clip, 60, seed=3)
    assert np.array_equal(chosen.means, again.means)


def test_a_clip_that_only_moves_is_sampled_from_its_first_frame() -> None:
    first = random_splats(50, seed=1)
    moved = Splats(**{**dict(first.arrays()), "means": first.means + np.float32(1)})
    chosen = training_splats("clip", 2, [(0, first), (1, moved)], 40, seed=0)
    assert len(chosen) == 40
    assert np.isin(chosen.means[:, 0], first.means[:, 0]).all()


def test_the_same_frame_again_adds_nothing() -> None:
    first = random_splats(50, seed=1)
    copy = first.take(np.arange(50))
    once, twice = (training_splats("clip", 2, [(0, first), (1, again)], 40, seed=0) for again in (first, copy))
    assert all(np.array_equal(a, b) for (_, a), (_, b) in zip(once.arrays(), twice.arrays(), strict=True))


def test_frames_of_another_degree_are_named() -> None:
    clip = [(0, random_splats(5)), (7, random_splats(5, degree=1))]
    with pytest.raises(SceneError, match="clip, frame 7: SH degree 1, but 0 before"):
        training_splats("clip", 2, clip, 10, seed=0)


def test_opacities_of_one_splat_are_kept_where_all_others_turn_and_change_colour() -> None:
    first, opacities = random_splats(1000, seed=1), np.array([2, 3, 4, 5], np.float32)
    clip = [(0, first)]
    for frame, opacity in enumerate(opacities, 1):
        other = random_splats(1000, seed=10 + frame)
        fading = first.logit_opacities.copy()
        fading[7] = opacity
        clip.append((frame, Splats(**{**dict(other.arrays()), "means": first.means, "logit_opacities": fading})))
    chosen = training_splats("clip", 5, clip, 400, seed=0)
    assert len(chosen) == 400
    assert np.isin(opacities, chosen.logit_opacities).all()
