"""The rasteriser's hard cases drawn by the shaders: the bounds are those of the ``cpu`` backend's levels."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from cags_common.raster import Exactness, Footprint, RasterScene, RenderedView, RenderOptions, create
from cags_common.raster.cpu import BOUNDS
from cags_gpu.device import source
from cags_gpu.keeper import Keeper
from cags_gpu.raster import GpuRasteriser
from support.gpu import any_gpu, needs_adapter, rasteriser
from support.hard_cases import CASES, USUAL_OF_SINGLE_PRECISION
from support.raster_scenes import assert_sound

pytestmark = needs_adapter


@cache
def drawn(name: str) -> tuple[RenderedView, RasterScene]:
    """The case's reference view, and the scene on the device."""
    make, cam = CASES[name]
    splats = make()
    return create("oracle").load(splats).render(cam, RenderOptions(contribution=True)), rasteriser().load(splats)


@pytest.mark.parametrize("exactness", Exactness)
@pytest.mark.parametrize("name", CASES)
def test_is_sound_and_within_the_bound_of_its_level(name: str, exactness: Exactness) -> None:
    right, scene = drawn(name)
    ours = scene.render(CASES[name][1], RenderOptions(exactness=exactness, contribution=True))
    assert_sound(ours)
    bound = BOUNDS[exactness]
    error = np.abs(ours.rgb - right.rgb) / max(1.0, float(right.rgb.max()))
    usual = max(bound.usual, USUAL_OF_SINGLE_PRECISION.get(name, 0.0))
    assert np.quantile(error.max(axis=2), 0.99, method="lower") <= usual
    assert error.max() <= bound.largest
    assert np.abs(ours.alpha - right.alpha).max() <= bound.largest


@cache
def of_whole_tiles() -> GpuRasteriser:
    """The backend, but each quarter of a tile looks at every entry of the tile."""
    own = Keeper(any_gpu)
    workspace = own.current()
    assert workspace is not None
    every = "for (var q = 0u; q < 4u; q++) { atomicOr(&touching[q * WORDS + lane / 32u], 1u << (lane % 32u)); }"
    text = source("blend").replace("marked(lane, drawn, tile);", every)
    assert every in text
    workspace.gpu._made["module", "blend"] = workspace.gpu.device.create_shader_module(code=text)
    return GpuRasteriser(own)


@pytest.mark.parametrize("exactness", [Exactness.EXACT, Exactness.FAST])
@pytest.mark.parametrize("name", CASES)
def test_quarters_of_tiles_leave_out_nothing_that_is_seen(name: str, exactness: Exactness) -> None:
    options = RenderOptions(exactness=exactness, contribution=True)
    make, cam = CASES[name]
    right, ours = of_whole_tiles().load(make()).render(cam, options), drawn(name)[1].render(cam, options)
    for field in ("rgb", "alpha", "depth", "contribution"):
        np.testing.assert_array_equal(getattr(ours, field), getattr(right, field), err_msg=field)


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("footprint", [Footprint(0.0, 0.3), Footprint(0.3 / 36, 1 / 12)], ids=["filtered", "client"])
def test_other_footprints_are_sound(name: str, footprint: Footprint) -> None:
    _, scene = drawn(name)
    cam = CASES[name][1]
    options = RenderOptions(footprint=footprint, exactness=Exactness.EXACT, contribution=True)
    assert_sound(scene.render(cam, options))
