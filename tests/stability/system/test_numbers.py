"""Numbers at their limits: far from the origin, denormal, degenerate, near a half-turn of view, and long sums.

Each bound comes from the arithmetic and not from a run; the comment beside it says how.
"""

from __future__ import annotations

import math
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cags_client.frame.align import ALIGNERS, Aligned, ReferencePicture
from cags_client.frame.align import create as create_aligner
from cags_client.frame.restore import RestoreInput
from cags_client.frame.restore import create as create_restorer
from cags_common import raster
from cags_common.geometry import Camera, Intrinsics, Pose
from cags_common.metrics import flicker, psnr, ssim
from cags_common.raster.base import Exactness, RenderOptions
from cags_common.raster.cpu import BOUNDS
from cags_encoder.quantiser.kmeans import NearestCentre, kmeans
from cags_protocol.timeline import Timeline
from cags_server.fov.base import MAX_REFERENCE_FOV_RAD, widened
from cags_server.ratecontrol import RATE_POLICIES, Observation, TileView, create_rate_policy
from support.raster_scenes import camera, random_splats

DENORMAL = np.float32(1e-42)
EXACT = RenderOptions(exactness=Exactness.EXACT)
SMALL = Intrinsics.of_fov(48, 36, 1.0, 0.8)


# ------------------------------------------------------------------------------------------- far from the origin, drift


@pytest.mark.parametrize("shift", [2.0**10, 2.0**15, -(2.0**15)])
def test_a_move_that_float32_holds_exactly_does_not_change_the_picture(shift: float) -> None:
    """Positions on a grid of 2^-8 stay exact up to 2^15 (24 bits), so all that may differ is the level's own rounding.

    A renderer that subtracted the camera after rotating would lose 15 of 24 bits here: a hundredth of a unit.
    """
    near = random_splats(400)
    means = np.round(near.means * 256) / np.float32(256)
    means[:, 2] = (np.arange(400, dtype=np.float32) - 200) / 64  # no two at one depth: ties go by content, which moves
    near = replace(near, means=means)
    far = replace(near, means=near.means + np.float32(shift))
    eye = camera()
    moved = eye.at(Pose(tuple(c + shift for c in eye.pose.position), eye.pose.rotation))  # type: ignore[arg-type]
    here, there = (raster.create("auto").load(s).render(c, EXACT).rgb for s, c in ((near, eye), (far, moved)))
    assert np.abs(here - there).max() <= BOUNDS[Exactness.EXACT].largest
    assert np.quantile(np.abs(here - there), 0.99) <= BOUNDS[Exactness.EXACT].usual


def test_ten_thousand_updates_leave_what_one_load_gives() -> None:
    """Updates replace, they do not add: no error may build up, so the pictures are equal bit by bit."""
    rng, splats = np.random.default_rng(0), random_splats(64, degree=1)
    scene = raster.create("auto").load(splats)
    held = {name: array.copy() for name, array in splats.arrays()}
    for _ in range(10_000):
        rows = rng.choice(64, size=3, replace=False)
        fresh = random_splats(3, degree=1, seed=int(rng.integers(1 << 30)))
        for name, array in fresh.arrays():
            held[name][rows] = array
        scene.update(rows, replace(splats, **held))
    loaded = raster.create("auto").load(replace(splats, **held))
    view, other = scene.render(camera(), EXACT), loaded.render(camera(), EXACT)
    np.testing.assert_array_equal(view.rgb, other.rgb)
    np.testing.assert_array_equal(view.depth, other.depth)


@pytest.mark.parametrize("fps", [24000 / 1001, 30000 / 1001, 25.0, 60.0])
def test_the_ten_millionth_frame_is_due_to_the_microsecond(fps: float) -> None:
    """A product and one rounding, not a sum: half a microsecond, and 2^-53 of four days besides."""
    timeline = Timeline(fps, 10**7 + 1)
    for tick in (1, 10_000, 10**7):
        exact = Fraction(tick) * 1_000_000 / Fraction(fps)
        assert abs(timeline.display_us(tick) - exact) <= Fraction(1, 2) + Fraction(1, 1000)


# ------------------------------------------------------------------------------------------------ denormal and constant


@pytest.mark.parametrize("level", [0.0, float(DENORMAL), 1.0])
def test_metrics_of_constant_and_denormal_pictures_are_finite(level: float) -> None:
    one, other = np.full((32, 40, 3), level, np.float32), np.full((32, 40, 3), DENORMAL, np.float32)
    figures = psnr(one, other), ssim(one, other), flicker(one, other, other, one)
    assert all(map(math.isfinite, figures))
    assert psnr(one, one) == 100
    assert ssim(one, one) == pytest.approx(1, abs=1e-6)


@pytest.mark.parametrize("restorer", ["reference", "srresnet"])
@pytest.mark.parametrize("level", [0.0, float(DENORMAL), 0.5, 1.0])
def test_pictures_of_one_colour_are_restored_to_finite_colours(restorer: str, level: float) -> None:
    flat = np.full((36, 48, 3), level, np.float32)
    reference = ReferencePicture(np.full((36, 48, 3), 1 - level, np.float32), Camera(SMALL, Pose.identity()), 0)
    aligned = _aligned(reference, np.full((36, 48), 2.0, np.float32))
    shown = create_restorer(restorer).restore(RestoreInput(flat, aligned, 0.0))
    assert np.isfinite(shown).all()
    assert shown.min() >= 0
    assert shown.max() <= 1


@pytest.mark.parametrize("depth", [float(DENORMAL), 1e-30, 1e30, 3e38, np.inf, np.nan, -1.0])
@pytest.mark.parametrize("name", sorted(ALIGNERS.names()))
def test_depths_at_the_limits_of_float32_give_no_colour_that_is_not_finite(name: str, depth: float) -> None:
    picture = np.random.default_rng(0).random((36, 48, 3)).astype(np.float32)
    there = Camera(SMALL, Pose((0.1, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)))
    aligned = _aligned(ReferencePicture(picture, there, 0), np.full((36, 48), depth, np.float32), name)
    for array in (aligned.rgb, aligned.confidence, *aligned.geometry.projected):
        assert np.isfinite(array).all()


def _aligned(reference: ReferencePicture, depth: np.ndarray, name: str = "fast") -> Aligned:
    return create_aligner(name).align(reference, depth, Camera(SMALL, Pose.identity()))


# -------------------------------------------------------------------------------------------------- degenerate training


@pytest.mark.parametrize(
    "points",
    [
        np.zeros((500, 3), np.float32),
        np.full((500, 3), 7.5, np.float32),
        np.repeat(np.eye(3, dtype=np.float32), 200, axis=0),
        np.random.default_rng(0).random((500, 3)).astype(np.float32) * DENORMAL,
        np.random.default_rng(1).random((500, 3)).astype(np.float32) * np.float32(1e15),
        np.concatenate([np.zeros((499, 3), np.float32), np.full((1, 3), 1e6, np.float32)]),
        np.linspace(0, 1, 500, dtype=np.float32)[:, None] * np.ones((1, 3), np.float32),
    ],
    ids=["zero", "constant", "duplicates", "denormal", "huge", "one outlier", "one line"],
)
@pytest.mark.parametrize("clusters", [1, 16, 256, 1024])
def test_kmeans_of_degenerate_data_is_no_worse_than_one_mean(points: np.ndarray, clusters: int) -> None:
    """However the data lie, centres are finite and at most as many as asked, and cost no more than a single mean."""
    centres = kmeans(points, clusters, seed=0)
    assert 1 <= len(centres) <= clusters
    assert np.isfinite(centres).all()
    wide = points.astype(np.float64)
    nearest = centres[NearestCentre(centres)(points)].astype(np.float64)
    single = np.square(wide - wide.mean(axis=0)).sum()
    rounding = np.square(np.spacing(np.abs(points).max()).astype(np.float64)) * points.size
    assert np.square(wide - nearest).sum() <= single * (1 + 1e-5) + rounding


# ----------------------------------------------------------------------------------------------------- limits of policy


@pytest.mark.parametrize(
    "name", sorted(set(RATE_POLICIES.names()) - {"buffer"})
)  # which looks at the wait, not the budget
@pytest.mark.parametrize("bps", [0.0, 1.0, 10e9, 1e15])
@given(data=st.data())
def test_rate_policies_keep_to_any_budget(name: str, bps: float, data: st.DataObject) -> None:
    sizes = st.lists(st.integers(0, 200_000), min_size=3, max_size=3).map(tuple)
    made = data.draw(
        st.lists(st.tuples(st.integers(0, 3), st.integers(0, 10**6), sizes, st.floats(0, 1e30)), max_size=8)
    )
    tiles = tuple(TileView(0, i, d, v, s, weight=w) for i, (d, v, s, w) in enumerate(made))
    budget = int(bps / 8 / 30)
    decision = create_rate_policy(name).decide(Observation(0, budget, tiles, (20.0, 3.0, 1.0), 160))
    assert 0 <= decision.bytes <= budget
    assert len({u.tile for u in decision.upgrades}) == len(decision.upgrades)


@pytest.mark.parametrize("fov_deg", [1.0, 90.0, 170.0, 179.0])
@pytest.mark.parametrize("margin", [0.0, 0.1, 4.0, 1e9])
def test_no_margin_widens_a_view_to_a_half_turn(fov_deg: float, margin: float) -> None:
    """At 180 degrees a pinhole's focal length is 0; the bound keeps the reference's finite."""
    client = Intrinsics.of_fov(64, 48, math.radians(fov_deg), math.radians(min(fov_deg, 120.0)))
    wide = widened(client, (margin, margin), 400, 300)
    own = math.radians(fov_deg)
    assert own - 1e-9 <= wide.fov_rad[0] <= max(own, MAX_REFERENCE_FOV_RAD) + 1e-9
    assert wide.fx_px > 0.1


# ------------------------------------------------------------------------------------------------------------ long sums


def test_an_average_over_ten_million_pixels_keeps_its_sixth_digit() -> None:
    """In float32 a plain sum stops growing at 2^24 times its addend; these add up in float64."""
    truth = np.full((2048, 2048, 3), 0.25, np.float32)
    picture = truth + np.float32(0.01)
    exact = -20 * math.log10(float(np.float32(0.26)) - 0.25)
    assert psnr(picture, truth) == pytest.approx(exact, abs=1e-4)
    assert flicker(picture, truth, truth, truth) == pytest.approx(255 * (float(np.float32(0.26)) - 0.25), rel=1e-5)
