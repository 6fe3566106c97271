"""The focus of a scene."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cags_common.splats import Splats
from cags_encoder.formats import write_splats
from cags_encoder.scenes import open_scene
from cags_encoder.scenes.source import SEEN_SIGMAS, focus_of, is_still
from support.splat_files import random_splats


def at(means: np.ndarray[tuple[int, ...], np.dtype[np.float64]], opacity: float = 2.0) -> Splats:
    arrays = dict(random_splats(len(means), 0).arrays())
    logits = np.full(len(means), opacity, np.float32)
    return Splats(**{**arrays, "means": means.astype(np.float32), "logit_opacities": logits})


def test_floaters_and_faint_splats_do_not_move_it() -> None:
    rng = np.random.default_rng(0)
    thing = at(rng.normal(size=(2000, 3)) * 0.3 + [1, 2, 3])
    far = at(rng.normal(size=(60, 3)) * 500)
    faint = at(rng.normal(9, 1, (2000, 3)), opacity=-9.0)
    focus = focus_of(Splats.concatenate([thing, far, faint]))
    np.testing.assert_allclose(focus.centre, [1, 2, 3], atol=0.05)
    assert focus.radius == pytest.approx(0.3 * 2.15, rel=0.1)


def test_the_middle_of_a_thing_above_its_ground() -> None:
    rng = np.random.default_rng(0)
    ground = rng.uniform(-1, 1, (3000, 3)) * [1, 0, 1]
    figure = rng.uniform(-0.2, 0.2, (3000, 3)) + np.array([0, 1, 0])
    assert 0.4 < focus_of(at(np.concatenate([ground, figure]))).centre[1] < 0.8


def test_one_splat_has_a_ball_around_it() -> None:
    splat = at(np.array([[5.0, 6.0, 7.0]]))
    focus = focus_of(splat)
    assert focus.centre == (5, 6, 7)
    assert focus.radius == pytest.approx(SEEN_SIGMAS * np.exp(splat.log_scales.max()))


@pytest.mark.parametrize("power", [-9, -6, -3, 3])
@pytest.mark.parametrize("count", [1, 200])
def test_it_scales_with_the_scene(count: int, power: int) -> None:
    """The same scene in another unit."""
    splats = at(np.random.default_rng(0).normal(size=(count, 3)))
    unit = 10.0**power
    log_scales = splats.log_scales + np.float32(np.log(unit))
    scaled = focus_of(replace(splats, means=splats.means * np.float32(unit), log_scales=log_scales))
    here = focus_of(splats)
    assert scaled.radius == pytest.approx(unit * here.radius, rel=1e-5)
    assert scaled.centre == pytest.approx([unit * part for part in here.centre], rel=1e-5, abs=unit * 1e-5)


def test_sizes_that_no_bundle_could_hold_are_limited() -> None:
    splats = at(np.zeros((3, 3)))
    assert focus_of(replace(splats, log_scales=np.full((3, 3), -300, np.float32))).radius > 0
    assert focus_of(replace(splats, log_scales=np.full((3, 3), 1e30, np.float32))).radius < 1e12


def test_only_a_scene_of_one_file_is_still(tmp_path: Path) -> None:
    for number in range(2):
        write_splats(tmp_path / f"{number}.ply", at(np.ones((20, 3)) * number))
    single, clip = open_scene(f"{tmp_path}/0.ply:frames=3"), open_scene(str(tmp_path))
    assert is_still(single) and single.frame(0) is single.frame(2) and single.ids(0) is single.ids(2)
    assert not is_still(clip) and not is_still(open_scene("procedural:size=500,frames=2"))
    assert not is_still(open_scene(f"{tmp_path}/0.ply:shuffle=1"))
