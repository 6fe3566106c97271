"""Corrections fade where the reference stands far aside of what is looked at."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import cags_kernels
from cags_client.align import ReferencePicture, create
from cags_client.align.base import Reprojection
from cags_client.restore import RestoreInput
from cags_client.restore.affine import AffineRestorer
from cags_client.restore.parallax import HALF_AT, MISSING_POWER, MISSING_STEP, kept, placed, relative_step
from cags_common.geometry import Camera, Intrinsics, Pose
from cags_common.raster.base import RenderedView

LARGE, SMALL = Intrinsics.of_fov(64, 48, 1.0, 0.8), Intrinsics.of_fov(32, 24, 1.2, 1.0)


def geometry(depth: np.ndarray, step: float) -> Reprojection:
    there = Pose((step, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))
    return Reprojection(depth.astype(np.float32), Camera(LARGE, Pose.identity()), Camera(SMALL, there))


@given(st.floats(0.0, 1.0), st.floats(0.1, 10.0))
def test_the_share_is_that_of_the_definition(step: float, depth: float) -> None:
    share = kept(geometry(np.full((48, 64), depth), step))
    expected = 1 / (1 + (step / depth / HALF_AT) ** 8)
    if share is None:
        assert expected > 0.98
    else:
        np.testing.assert_allclose(share, expected, atol=1e-4)


def test_a_turn_and_a_small_step_cost_nothing() -> None:
    turned = replace(geometry(np.ones((48, 64)), 0.0), reference=Camera(SMALL, Pose((0, 0, 0), (0.9, 0, 0.436, 0))))
    assert kept(turned) is None
    assert kept(geometry(np.full((48, 64), 1.0), 0.1)) is None


def test_what_is_far_keeps_its_correction_beside_what_is_near() -> None:
    depth = np.full((48, 64), 5.0)
    depth[:, :32] = 0.2
    share = kept(geometry(depth, 0.3))
    assert share is not None
    assert share[:, :32].max() < 1e-4
    assert share[:, 32:].min() > 0.999


@pytest.mark.parametrize("void", [np.inf, np.nan, 0.0, -1.0, 1e-30])
def test_void_and_depths_that_are_none_stay_finite(void: float) -> None:
    depth = np.full((48, 64), 0.5)
    depth[10:20] = void
    share = kept(geometry(depth, 0.5))
    assert share is not None
    assert np.isfinite(share).all()
    assert kept(geometry(np.full((48, 64), np.inf), 0.5)) is None


@pytest.mark.parametrize("native", [True, False])
def test_a_correction_from_far_aside_leaves_the_picture_as_it_is(monkeypatch: pytest.MonkeyPatch, native: bool) -> None:
    if native and not cags_kernels.native_available():
        pytest.skip(cags_kernels.why_unavailable())
    monkeypatch.setattr(cags_kernels, "native_available", lambda: native)
    rng = np.random.default_rng(1)
    distorted = np.full((48, 64, 3), 0.5, np.float32) + 0.1 * rng.random((48, 64, 3)).astype(np.float32)
    alpha, own = np.ones((48, 64), np.float32), np.full((24, 32, 3), 0.5, np.float32)
    seen = RenderedView(own, np.ones((24, 32), np.float32), None, None)
    changes = []
    for step in (0.05, 0.6):
        g = geometry(np.full((48, 64), 1.0), step)
        reference = ReferencePicture(own + np.float32(0.2), replace(g.reference), 0)
        given_ = RestoreInput(distorted, alpha, create("fast").align(reference, g.depth, g.camera), reference, seen)
        sure = given_.aligned.confidence > 0.99
        assert sure.any()
        changes.append(np.abs(AffineRestorer().restore(given_) - distorted)[sure].max())
    assert changes[0] > 0.15
    assert changes[1] < 0.005


def test_what_is_missing_counts_from_near_and_not_from_aside() -> None:
    own = np.zeros((24, 32, 3), np.float32)
    fields = np.zeros((24, 32, 4), np.float32)
    fields[:, :16, 1:] = 0.02
    fields[:, 16:, 1:] = np.sqrt(MISSING_POWER / 3)
    near, aside = placed(fields, own, MISSING_STEP / 4), placed(fields, own, MISSING_STEP)
    np.testing.assert_allclose(near, fields, rtol=0.005)
    np.testing.assert_allclose(aside[:, :12], fields[:, :12], rtol=0.001)
    np.testing.assert_allclose(aside[:, 20:], fields[:, 20:] / 2, rtol=0.001)


def test_a_step_is_measured_against_the_median_depth_of_what_is_there() -> None:
    depth = np.full((48, 64), 2.0)
    depth[:20], depth[20:24], depth[24:28] = np.inf, 0.0, np.nan
    assert relative_step(geometry(depth, 0.5)) == pytest.approx(0.25)
    assert relative_step(geometry(np.full((48, 64), np.inf), 0.5)) == 0.0
