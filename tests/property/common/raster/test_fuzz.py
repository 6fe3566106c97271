"""Random scenes, cameras and options never crash the native code and never give a pixel that is not finite.

The nightly run repeats this under the address and undefined-behaviour sanitizers, see ``kernels/sanitize.py``.
"""

from __future__ import annotations

import hypothesis.extra.numpy as hnp
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import cags_kernels
from cags_common.errors import SceneError
from cags_common.geometry import Camera, Intrinsics, Pose
from cags_common.raster import DepthKind, Exactness, Footprint, RenderOptions, create
from cags_common.splats import SH_REST_OF_DEGREE, Splats
from support.raster_scenes import F, assert_sound, changed

pytestmark = pytest.mark.skipif(not cags_kernels.native_available(), reason=cags_kernels.why_unavailable())

any_float = st.floats(width=32, allow_nan=False, allow_infinity=False)
usual = st.floats(-8, 8, width=32)
finite = st.one_of(usual, any_float)


@st.composite
def scenes(draw: st.DrawFn, elements: st.SearchStrategy[float] = finite) -> Splats:
    n, degree = draw(st.integers(0, 40)), draw(st.integers(0, 3))

    def column(*shape: int) -> np.ndarray:
        return draw(hnp.arrays(F, (n, *shape), elements=elements))

    quats = column(4)
    quats[np.linalg.norm(quats.astype(np.float64), axis=1) < 1e-6] = (1, 0, 0, 0)
    return Splats(column(3), quats, column(3), column(), column(3), column(SH_REST_OF_DEGREE[degree], 3))


@st.composite
def cameras(draw: st.DrawFn) -> Camera:
    width, height = draw(st.integers(1, 80)), draw(st.integers(1, 80))
    fov = st.floats(0.02, 3.12)
    axis = st.floats(-1, 1)
    rotation = tuple(draw(axis) for _ in range(4))
    if sum(c * c for c in rotation) < 1e-6:
        rotation = (1.0, 0.0, 0.0, 0.0)
    position = tuple(draw(st.floats(-1e6, 1e6) | st.floats(-5, 5)) for _ in range(3))
    near = draw(st.floats(1e-6, 10))
    return Camera(Intrinsics.of_fov(width, height, draw(fov), draw(fov)), Pose(position, rotation), near)


options = st.builds(
    RenderOptions,
    footprint=st.sampled_from([Footprint.classic(), Footprint(0.0, 0.3), Footprint(0.01, 1 / 12), Footprint(1e-4)]),
    exactness=st.sampled_from(Exactness),
    depth=st.sampled_from(DepthKind),
    contribution=st.booleans(),
    void_alpha=st.floats(0, 1),
    max_sh_degree=st.integers(0, 3),
    threads=st.integers(1, 3),
)
quick = settings(max_examples=150, suppress_health_check=list(HealthCheck))


@quick
@given(scenes(), cameras(), options)
def test_any_scene_renders_soundly(splats: Splats, cam: Camera, chosen: RenderOptions):
    scene = create("cpu").load(splats)
    if np.abs(splats.sh0).max(initial=0) < 1e30 and np.abs(splats.sh_rest).max(initial=0) < 1e30:
        assert_sound(scene.render(cam, chosen))
    else:  # colours themselves overflow; the geometry must not
        view = scene.render(cam, chosen)
        assert ((view.alpha >= 0) & (view.alpha <= 1)).all()


@quick
@given(scenes(usual), scenes(usual), st.data())
def test_any_update_equals_a_load(splats: Splats, others: Splats, data: st.DataObject):
    count = min(len(splats), len(others))
    if others.sh_rest.shape[1] != splats.sh_rest.shape[1] or count == 0:
        return
    rows = np.array(data.draw(st.permutations(range(len(splats)))))[:count]
    new = changed(splats, rows, others.take(slice(0, count)))
    scene = create("cpu").load(splats)
    scene.update(rows, new, data.draw(st.integers(1, 3)))
    cam = Camera(Intrinsics.of_fov(40, 30, 1.5, 1.2), Pose((0.0, 0.0, -9.0), (1.0, 0.0, 0.0, 0.0)))
    loaded = create("cpu").load(new)
    np.testing.assert_array_equal(scene.render(cam, RenderOptions()).rgb, loaded.render(cam, RenderOptions()).rgb)


@quick
@given(scenes(st.floats(width=32)))
def test_what_is_not_finite_is_refused_and_never_drawn(splats: Splats):
    bad = [
        name
        for name, array in splats.arrays()
        if np.isnan(array).any() or (np.isinf(array).any() and "opac" not in name)
    ]
    if bad:
        with pytest.raises(SceneError, match=r"\[\d+\]"):
            create("cpu").load(splats)
    else:
        create("cpu").load(splats)
