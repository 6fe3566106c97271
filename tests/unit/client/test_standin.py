"""The reference in the splats' place: where they are not those of the scene, and nowhere else."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

import cags_kernels
from cags_client import align
from cags_client.align import ReferencePicture
from cags_client.standin import FAR, Drawn, StandIn, disagreement, lay_over, surrogate_depth
from cags_common.geometry import F32, Camera, Intrinsics, Pose
from cags_common.metrics import psnr
from cags_common.raster.base import RenderedView
from cags_kernels import align as kernels

HERE = Camera(Intrinsics.of_fov(160, 120, 1.2, 1.0), Pose.identity())
THERE = Camera(Intrinsics.of_fov(120, 90, 1.4, 1.2), Pose((0.3, -0.1, 0.05), (0.9995, 0.02, 0.02, 0.01)))
WALL = 4.0


HOLE = -1.0, 0.6
"""The part of the wall, along x and y, that is missing where something is missing."""


def wall(camera: Camera, *, squares: float = 3.0, torn: bool = False) -> F32:
    """A chequered, tinted wall at z = WALL, seen from ``camera``; ``torn`` has a hole in it."""
    i, pose = camera.intrinsics, camera.pose
    u, v = np.meshgrid(np.arange(i.width_px) + 0.5, np.arange(i.height_px) + 0.5)
    rays = np.stack([(u - i.cx_px) / i.fx_px, (v - i.cy_px) / i.fy_px, np.ones_like(u)], -1) @ pose.rotation_matrix.T
    reach = (WALL - pose.position[2]) / rays[..., 2]
    x, y = (pose.position[k] + rays[..., k] * reach for k in (0, 1))
    shade = 0.5 + 0.4 * np.sin(squares * x) * np.sin(squares * y)
    rgb = np.stack([shade, 0.9 * shade + 0.02 * x, 0.8 * shade - 0.02 * y], -1).clip(0, 1).astype(np.float32)
    if torn:
        rgb[(HOLE[0] < x) & (x < HOLE[1]) & (HOLE[0] < y) & (y < HOLE[1])] = 0
    return rgb


def view(rgb: F32) -> RenderedView:
    return RenderedView(rgb, np.ones(rgb.shape[:2], np.float32), None, None)


def drawn(rgb: F32) -> Drawn:
    """A picture of the wall; black is void."""
    void = ~rgb.any(axis=-1)
    return Drawn(rgb, np.where(void, 0, 1).astype(np.float32), np.where(void, np.inf, WALL).astype(np.float32), HERE)


def painted(mine: Drawn, own: F32, trust: float = 1.0) -> F32:
    reference = ReferencePicture(wall(THERE), THERE, 0)
    return StandIn(align.create("auto")).paint(mine.rgb, mine, reference, view(own), trust)


def test_splats_that_agree_with_the_reference_keep_their_picture():
    mine = drawn(wall(HERE))
    assert painted(mine, wall(THERE)) is mine.rgb


@pytest.mark.parametrize("colours", [lambda c: 0.9 * c + 0.03, lambda c: np.round(c * 8) / 8])
def test_wrong_colours_are_left_to_restoration(colours):
    mine = drawn(colours(wall(HERE)).astype(np.float32))
    assert painted(mine, colours(wall(THERE)).astype(np.float32)) is mine.rgb


def test_a_hole_is_filled_and_the_rest_left_alone():
    mine = drawn(wall(HERE, torn=True))
    out, void = painted(mine, wall(THERE, torn=True)), mine.alpha == 0
    assert np.square(out - wall(HERE))[void].mean() < 0.07**2
    assert psnr(out, wall(HERE)) > 30
    np.testing.assert_array_equal(out[:, -12:], mine.rgb[:, -12:])


def test_splats_of_another_moment_give_way():
    stale = drawn(wall(HERE, squares=5.0))
    out = painted(stale, wall(THERE, squares=5.0))
    assert psnr(out, wall(HERE)) > psnr(stale.rgb, wall(HERE)) + 3


def test_a_surface_that_bends_badly_keeps_its_picture():
    """The same splats, but a depth by which the client's own view does not come out."""
    stale = drawn(wall(HERE, squares=5.0))
    wrong = replace(stale, depth=np.full_like(stale.depth, 0.4))
    right, bad = painted(stale, wall(THERE, squares=5.0)), painted(wrong, wall(THERE, squares=5.0))
    assert np.abs(bad - stale.rgb).mean() < 0.25 * np.abs(right - stale.rgb).mean()


def test_a_client_without_splats_sees_the_reference_turned():
    size = 120, 160
    black, clear, void = np.zeros((*size, 3), np.float32), np.zeros(size, np.float32), np.full(size, np.inf, np.float32)
    nothing = Drawn(black, clear, void, HERE)
    there = replace(THERE, pose=Pose(HERE.pose.position, THERE.pose.rotation))
    reference = ReferencePicture(wall(there), there, 0)
    out = StandIn(align.create("auto")).paint(nothing.rgb, nothing, reference, view(np.zeros_like(reference.rgb)), 1.0)
    assert psnr(out[8:-8, 8:-8], wall(HERE)[8:-8, 8:-8]) > 30
    assert (surrogate_depth(nothing) == FAR).all()


def test_without_trust_nothing_is_painted():
    mine = drawn(np.zeros((120, 160, 3), np.float32))
    assert painted(mine, np.zeros((90, 120, 3), np.float32), trust=0.0) is mine.rgb


def test_another_reference_is_compared_anew():
    stand_in = StandIn(align.create("auto"))
    mine, reference = drawn(wall(HERE, squares=5.0)), ReferencePicture(wall(THERE), THERE, 0)
    agreeing, stale = view(wall(THERE)), view(wall(THERE, squares=5.0))
    assert stand_in.paint(mine.rgb, mine, reference, agreeing, 1.0) is mine.rgb
    assert stand_in.paint(mine.rgb, mine, reference, stale, 1.0) is not mine.rgb


def test_disagreement_is_what_no_local_fit_explains():
    seen = wall(THERE)
    assert disagreement(seen, seen).max() < 1e-3
    assert disagreement(seen, 0.9 * seen + 0.02).max() < 0.04
    assert disagreement(seen, np.zeros_like(seen)).mean() > 0.2


def test_depth_is_carried_over_holes():
    np.testing.assert_allclose(surrogate_depth(drawn(wall(HERE, torn=True))), WALL, rtol=1e-3)


sizes = st.tuples(st.integers(1, 23), st.integers(1, 23))


@settings(max_examples=60)
@given(sizes, sizes, st.data())
def test_whatever_is_drawn_the_picture_stays_one(mine: tuple[int, int], theirs: tuple[int, int], data: st.DataObject):
    unit = st.floats(0, 1, width=32)
    depth = data.draw(hnp.arrays(np.float32, mine, elements=st.floats(width=32)))
    rgb, alpha = (data.draw(hnp.arrays(np.float32, shape, elements=unit)) for shape in ((*mine, 3), mine))
    seen, own = (data.draw(hnp.arrays(np.float32, (*theirs, 3), elements=unit)) for _ in range(2))
    here = Camera(Intrinsics.of_fov(mine[1], mine[0], 1.2, 1.0), Pose.identity())
    there = replace(THERE, intrinsics=Intrinsics.of_fov(theirs[1], theirs[0], 1.2, 1.0))
    before = rgb.copy()
    out = StandIn(align.create("auto")).paint(
        rgb, Drawn(rgb, alpha, depth, here), ReferencePicture(seen, there, 0), view(own), 1.0
    )
    np.testing.assert_array_equal(rgb, before)
    assert out.shape == rgb.shape
    assert np.isfinite(out).all()
    assert out.min() >= 0
    assert out.max() <= 1 + 1e-6


@pytest.mark.parametrize("instructions", ["portable", "avx2", "avx512"])
@pytest.mark.parametrize("shape", [(1, 1), (5, 7), (9, 8), (33, 67)])
def test_laying_over_is_the_weighted_mean_and_touches_nothing_else(instructions, shape):
    before = cags_kernels.instruction_set()
    try:
        cags_kernels.use_instruction_set(instructions)
    except cags_kernels.KernelError:
        pytest.skip(f"this processor does not run {instructions}")
    try:
        h, w = shape
        rng = np.random.default_rng(h)
        whole, over = rng.random((h + 4, w + 6, 3), np.float32), rng.random((h, w, 3), np.float32)
        share, confidence = rng.random((h, w + 3), np.float32)[:, :w], rng.random((h, w), np.float32)
        share[:, : w // 2] = 0
        part, out = np.s_[2 : 2 + h, 3 : 3 + w], whole.copy()
        lay_over(out[part], over, share, confidence, threads=2)
        weight = (share * confidence)[..., None]
        np.testing.assert_allclose(out[part], whole[part] + weight * (over - whole[part]), atol=1e-6)
        out[part][weight[..., 0] > 0] = whole[part][weight[..., 0] > 0]
        np.testing.assert_array_equal(out, whole)
    finally:
        cags_kernels.use_instruction_set(before)


def test_what_is_laid_over_must_fit():
    shown, share = np.zeros((4, 6, 3), np.float32), np.ones((4, 6), np.float32)
    with pytest.raises(ValueError, match="expected"):
        kernels.lay(shown, np.zeros((4, 5, 3), np.float32), share, share, 1)
    with pytest.raises(ValueError, match="whole rows"):
        kernels.lay(shown[:, ::2], np.zeros((4, 3, 3), np.float32), share[:, :3], share[:, :3], 1)
