"""What is refused before it is drawn, by name and index."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cags_common.errors import SceneError
from cags_common.raster import RenderOptions, create
from cags_common.raster.checks import drawable
from cags_common.splats import Splats
from support.raster_scenes import camera, random_splats


@pytest.mark.parametrize("name", ["means", "quats", "log_scales", "logit_opacities", "sh0", "sh_rest"])
@pytest.mark.parametrize("backend", ["oracle", "cpu"])
def test_nan_is_refused_by_name_and_index(name, backend):
    splats = random_splats(20, degree=1)
    getattr(splats, name)[13] = np.nan
    with pytest.raises(SceneError, match=rf"{name}\[13\].*not finite"):
        create(backend).load(splats)


def test_infinite_means_are_refused_and_infinite_opacities_clamped():
    splats = random_splats(5)
    splats.logit_opacities[:2] = np.inf, -np.inf
    assert drawable(splats).logit_opacities[:2].tolist() == [20.0, -20.0]
    splats.means[4, 1] = np.inf
    with pytest.raises(SceneError, match=r"means\[4\]"):
        drawable(splats)


def test_a_zero_quaternion_is_refused_and_a_tiny_one_is_not():
    splats = random_splats(5)
    splats.quats[2] = splats.quats[2] * np.float32(1e-6)
    drawable(splats)
    splats.quats[3] = 0
    with pytest.raises(SceneError, match=r"quats\[3\] is zero"):
        drawable(splats)


@pytest.mark.parametrize("backend", ["oracle", "cpu"])
def test_an_empty_scene_is_black_and_void(backend):
    scene = create(backend).load(random_splats(0))
    view = scene.render(camera(), RenderOptions(contribution=True))
    assert len(scene) == 0
    assert not view.rgb.any()
    assert not view.alpha.any()
    assert np.isinf(view.depth).all()
    assert view.contribution.shape == (0,)


def test_wrong_shapes_are_refused():
    splats = random_splats(5, degree=1)
    with pytest.raises(SceneError, match="quats has shape"):
        drawable(replace(splats, quats=splats.quats[:, :3]))
    with pytest.raises(SceneError, match="sh_rest has shape"):
        drawable(Splats(*(array for _, array in list(splats.arrays())[:5]), np.zeros((5, 4, 3), np.float32)))
