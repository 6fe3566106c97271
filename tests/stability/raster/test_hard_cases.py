"""Hard cases against the reference, in every level of exactness: finite, alpha in [0, 1], within the level's bound."""

from __future__ import annotations

import numpy as np
import pytest

import cags_kernels
from cags_common.raster import Exactness, Footprint, RenderOptions, create
from cags_common.raster.cpu import BOUNDS
from support.hard_cases import CASES, USUAL_OF_SINGLE_PRECISION, one_depth
from support.raster_scenes import assert_sound, tilted_camera

pytestmark = pytest.mark.skipif(not cags_kernels.native_available(), reason=cags_kernels.why_unavailable())

_rendered: dict[str, tuple[object, object]] = {}


def rendered(name: str) -> tuple[object, object]:
    """The case's reference view and the native scene, made once."""
    if name not in _rendered:
        make, cam = CASES[name]
        splats = make()
        options = RenderOptions(contribution=True)
        _rendered[name] = create("oracle").load(splats).render(cam, options), create("cpu").load(splats)
    return _rendered[name]


@pytest.mark.parametrize("exactness", Exactness)
@pytest.mark.parametrize("name", CASES)
def test_is_sound_and_within_the_bound_of_its_level(name: str, exactness: Exactness):
    right, scene = rendered(name)
    ours = scene.render(CASES[name][1], RenderOptions(exactness=exactness, contribution=True))
    assert_sound(ours)
    bound = BOUNDS[exactness]
    scale = max(1.0, float(right.rgb.max()))
    error = np.abs(ours.rgb - right.rgb) / scale
    usual = max(bound.usual, USUAL_OF_SINGLE_PRECISION.get(name, 0.0))
    assert np.quantile(error.max(axis=2), 0.99, method="lower") <= usual
    assert error.max() <= bound.largest
    assert np.abs(ours.alpha - right.alpha).max() <= bound.largest


@pytest.mark.parametrize("exactness", Exactness)
@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("footprint", [Footprint(0.0, 0.3), Footprint(0.3 / 36, 1 / 12)], ids=["filtered", "client"])
def test_other_footprints_are_sound(name, footprint, exactness):
    _, scene = rendered(name)
    cam = CASES[name][1]
    options = RenderOptions(footprint=footprint, exactness=exactness, contribution=True)
    assert_sound(scene.render(cam, options))


@pytest.mark.parametrize("exactness", Exactness)
@pytest.mark.parametrize(
    "name", ["one depth", "one depth, camera tilted", "one position", "odd size", "2^16 in one tile"]
)
def test_permuting_the_input_leaves_the_picture_unchanged(name, exactness):
    _, scene = rendered(name)
    make, cam = CASES[name]
    splats = make()
    order = np.random.default_rng(0).permutation(len(splats))
    options = RenderOptions(exactness=exactness)
    shuffled = create("cpu").load(splats.take(order)).render(cam, options)
    np.testing.assert_allclose(shuffled.rgb, scene.render(cam, options).rgb, atol=1e-6)


@pytest.mark.parametrize("backend", ["oracle", "cpu"])
def test_permuting_the_input_leaves_the_reference_unchanged_too(backend):
    splats, cam = one_depth().take(slice(0, 800)), tilted_camera(48, 32)
    order = np.random.default_rng(0).permutation(len(splats))
    views = [create(backend).load(s).render(cam, RenderOptions()).rgb for s in (splats, splats.take(order))]
    np.testing.assert_allclose(*views, atol=1e-6)
