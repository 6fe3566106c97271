"""Units of motion."""

import numpy as np

from cags_encoder.motion.steps import MOVE_STEP, motion_steps
from support.codec_scenes import cloud, with_changes


def test_large_splats_may_be_off_by_more_and_specks_by_no_less() -> None:
    splats = cloud(300, 0)
    sizes = np.repeat([-9.0, -5.0, -2.0], 100)[:, None] * np.ones((1, 3))
    codes = np.repeat(np.arange(3, dtype=np.uint32), 100)
    steps = motion_steps(with_changes(splats, log_scales=sizes.astype(np.float32)), codes, 4)
    small, middle, large, unused = steps.moves
    assert large == np.float32(np.exp(-2.0) * MOVE_STEP)
    assert small == middle * np.float32(1.0) or small < middle
    assert small >= np.exp(-9.0) * MOVE_STEP * 0.999 and unused > 0
    assert len(steps.turns) == 4 and min(steps.turns) > 0


def test_needles_are_told_more_exactly_than_discs() -> None:
    shape = np.concatenate([np.tile([-2.0, -5.0, -5.0], (50, 1)), np.tile([-2.0, -2.0, -5.0], (50, 1))])
    splats = with_changes(cloud(100, 0), log_scales=shape.astype(np.float32))
    needle, disc = motion_steps(splats, np.repeat(np.arange(2, dtype=np.uint32), 50), 2).turns
    assert needle < disc
