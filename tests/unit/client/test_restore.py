"""Restorers: what they must never do, and what the closed form must reach."""

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest

import cags_kernels
from cags_client import restore
from cags_client.align import Aligned, ReferencePicture, create
from cags_client.restore import RESTORERS, RestoreInput
from cags_client.restore.affine import AffineRestorer, AffineSettings, average_down, corrected_there, fields_of
from cags_common.errors import ConfigError
from cags_common.geometry import Camera, Intrinsics, Pose
from cags_common.metrics import MAX_PSNR_DB, psnr
from cags_common.raster.base import RenderedView

LARGE = Intrinsics.of_fov(160, 120, 1.0, 0.8)
SMALL = Intrinsics.of_fov(40, 30, 1.0, 0.8)
CAMERA = Camera(LARGE, Pose.identity())
RNG = np.random.default_rng(3)


def smooth(height: int, width: int, sigma: float, seed: int = 0) -> np.ndarray:
    noise = np.random.default_rng(seed).random((height, width, 3)).astype(np.float32)
    picture = cv2.GaussianBlur(noise, (0, 0), sigma)
    return (picture - picture.min()) / (picture.max() - picture.min())


def down(picture: np.ndarray) -> np.ndarray:
    return cv2.resize(picture, (40, 30), interpolation=cv2.INTER_AREA)


def inputs(truth: np.ndarray, distorted: np.ndarray, *, aligned: Aligned | None = None) -> RestoreInput:
    """The same view from the same pose, on a flat wall."""
    reference = ReferencePicture(down(truth), Camera(SMALL, Pose.identity()), 0)
    depth = np.full((120, 160), 2.0, np.float32)
    aligned = aligned or create("auto").align(reference, depth, CAMERA)
    ones = np.ones((30, 40), np.float32)
    own = RenderedView(down(distorted), ones, ones * 2, None)
    return RestoreInput(distorted, np.ones((120, 160), np.float32), aligned, reference, own)


@pytest.fixture(params=["kernels", "numpy"])
def affine(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> AffineRestorer:
    if request.param == "numpy":
        monkeypatch.setattr(cags_kernels, "native_available", lambda: False)
    elif not cags_kernels.native_available():
        pytest.skip(cags_kernels.why_unavailable())
    return AffineRestorer()


def test_a_colour_cast_is_taken_off(affine: AffineRestorer) -> None:
    truth = smooth(120, 160, 4)
    distorted = np.clip(truth * np.float32(0.8) + np.array([0.1, 0.0, 0.05], np.float32), 0, 1)
    restored = affine.restore(inputs(truth, distorted))
    assert psnr(restored, truth) > psnr(distorted, truth) + 5


def test_detail_of_the_clients_own_is_kept(affine: AffineRestorer) -> None:
    """The reference cannot hold a texture this fine; the client's splats can."""
    fine = 0.15 * np.where((np.indices((120, 160)).sum(axis=0) % 2)[..., None] > 0, 1.0, -1.0)
    truth = np.clip(0.5 * smooth(120, 160, 10) + 0.25 + fine, 0, 1).astype(np.float32)
    distorted = np.clip(truth + np.float32(0.1), 0, 1)
    restored = affine.restore(inputs(truth, distorted))
    upsampled = cv2.resize(down(truth), (160, 120), interpolation=cv2.INTER_LINEAR)
    assert psnr(restored, truth) > psnr(distorted, truth) + 6
    assert psnr(restored, truth) > psnr(upsampled, truth) + 6


def test_noise_like_differences_change_nothing(affine: AffineRestorer) -> None:
    """Splats as good as the reference can tell: the picture stays, to the last bit."""
    truth = smooth(120, 160, 3)
    given = inputs(truth, truth)
    noisy = np.clip(given.reference.rgb + RNG.normal(0, 3e-3, (30, 40, 3)).astype(np.float32), 0, 1)
    reference = ReferencePicture(noisy, given.reference.camera, 0)
    shown = affine.restore(RestoreInput(truth, given.alpha, given.aligned, reference, given.own))
    np.testing.assert_array_equal(shown, truth)


def test_where_the_reference_says_nothing_the_distorted_picture_stays(affine: AffineRestorer) -> None:
    truth = smooth(120, 160, 4)
    distorted = np.clip(truth + np.float32(0.2), 0, 1)
    given = inputs(truth, distorted)
    confidence = given.aligned.confidence.copy()
    confidence[:, :80] = 0
    aligned = Aligned(given.aligned.paint, confidence, given.aligned.occluded, given.aligned.geometry)
    restored = affine.restore(inputs(truth, distorted, aligned=aligned))
    np.testing.assert_array_equal(restored[:, :80], distorted[:, :80])
    assert np.abs(restored[:, 100:] - distorted[:, 100:]).mean() > 0.1


@pytest.mark.parametrize(("height", "width"), [(1, 1), (2, 70), (33, 64), (70, 65), (96, 130)])
@pytest.mark.parametrize("radius", [1, 2, 9])
def test_the_local_fit_of_any_size_is_as_defined(
    height: int, width: int, radius: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The kernels fit 64 pixels of 32 rows at a time: no seams, and the picture's ends are mirrored."""
    if not cags_kernels.native_available():
        pytest.skip(cags_kernels.why_unavailable())
    own, theirs = (RNG.random((height, width, 3), dtype=np.float32) for _ in range(2))
    camera = Camera(Intrinsics.of_fov(width, height, 1.0, 0.8), Pose.identity())
    reference, settings = ReferencePicture(theirs, camera, 0), AffineSettings(radius_cells=radius, threads=2)
    native = fields_of(own, reference, settings).copy()
    np.testing.assert_array_equal(native, fields_of(own, reference, replace(settings, threads=5)))
    monkeypatch.setattr(cags_kernels, "native_available", lambda: False)
    np.testing.assert_allclose(native, fields_of(own, reference, settings), atol=2e-4)


def test_kernels_and_numpy_agree(monkeypatch: pytest.MonkeyPatch) -> None:
    if not cags_kernels.native_available():
        pytest.skip(cags_kernels.why_unavailable())
    given = inputs(smooth(120, 160, 2), smooth(120, 160, 2, seed=1))
    for settings in (AffineSettings(), AffineSettings(radius_cells=7), AffineSettings(gain_prior=0.1)):
        native = AffineRestorer(settings).restore(given)
        with monkeypatch.context() as patch:
            patch.setattr(cags_kernels, "native_available", lambda: False)
            readable = AffineRestorer(settings).restore(given)
        np.testing.assert_allclose(native, readable, atol=2e-4)


@pytest.mark.parametrize("name", sorted(set(RESTORERS) & {"none", "reference", "affine"}))
@pytest.mark.parametrize("fill", [0.0, 1.0])
def test_pictures_stay_finite_and_in_range(name: str, fill: float) -> None:
    distorted = smooth(120, 160, 1)
    before = distorted.copy()
    flat = np.full((120, 160, 3), fill, np.float32)
    restored = restore.create(name).restore(inputs(flat, distorted))
    assert restored.shape == distorted.shape
    assert np.isfinite(restored).all()
    assert restored.min() >= 0
    assert restored.max() <= 1
    np.testing.assert_array_equal(distorted, before)


@pytest.mark.parametrize("size", [(1, 1), (3, 2), (1, 5)])
def test_tiny_pictures(affine: AffineRestorer, size: tuple[int, int]) -> None:
    width, height = size
    camera = Camera(Intrinsics.of_fov(width, height, 1.0, 1.0), Pose.identity())
    reference = ReferencePicture(np.full((height, width, 3), 0.7, np.float32), camera, 0)
    depth = np.ones((height, width), np.float32)
    distorted = np.full((height, width, 3), 0.3, np.float32)
    own = RenderedView(distorted, depth, depth, None)
    aligned = create("reference").align(reference, depth, camera)
    restored = affine.restore(RestoreInput(distorted, depth, aligned, reference, own))
    assert np.isfinite(restored).all()


def test_none_shows_the_distorted_picture_and_reference_the_aligned_one() -> None:
    truth, distorted = smooth(120, 160, 4), smooth(120, 160, 4, seed=1)
    given = inputs(truth, distorted)
    assert restore.create("none").restore(given) is distorted
    shown = restore.create("reference").restore(given)
    inside = given.aligned.confidence == 1
    np.testing.assert_allclose(shown[inside], given.aligned.rgb[inside], atol=1e-6)


def test_without_an_own_view_the_picture_is_averaged_through_the_alignment() -> None:
    truth = smooth(120, 160, 4)
    given = inputs(truth, truth)
    aligned = given.aligned
    low = average_down(truth, aligned.x, aligned.y, aligned.confidence, np.zeros((30, 40, 3), np.float32))
    assert psnr(low[1:-1, 1:-1], down(truth)[1:-1, 1:-1]) > 45
    silent = average_down(truth, aligned.x, aligned.y, aligned.confidence * 0, given.reference.rgb)
    assert psnr(silent, given.reference.rgb) == MAX_PSNR_DB


def test_an_unknown_restorer_is_named() -> None:
    with pytest.raises(ConfigError, match="'magic' is unknown; known: none"):
        restore.create("magic")
    assert math.isfinite(AffineSettings().gain_prior)


def slanted(truth: np.ndarray, distorted: np.ndarray, *, bend: float) -> RestoreInput:
    """The same pictures under a reference a step to the side; with ``bend`` a ripple of wrong depth."""
    given = inputs(truth, distorted)
    camera = Camera(SMALL, Pose((0.3, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)))
    ripple = np.sin(np.arange(160, dtype=np.float32) / 5)[None] * np.float32(bend)
    depth = (np.full((120, 160), 2.0, np.float32) * (1 + ripple)).astype(np.float32)
    reference = ReferencePicture(given.reference.rgb, camera, 0)
    return RestoreInput(distorted, given.alpha, create("auto").align(reference, depth, CAMERA), reference, given.own)


@pytest.mark.parametrize("sigma", [3, 6])
def test_splats_that_are_nearly_right_are_not_harmed_by_a_wrong_alignment(affine: AffineRestorer, sigma: int) -> None:
    truth = smooth(120, 160, sigma)
    distorted = np.clip(truth + 0.07 * (smooth(120, 160, 8, seed=1) - 0.5), 0, 1).astype(np.float32)
    given = slanted(truth, distorted, bend=0.3)
    trusting = AffineRestorer(AffineSettings(misregistration=0.0)).restore(given).copy()
    assert psnr(trusting, truth) < psnr(distorted, truth) - 0.12
    assert psnr(affine.restore(given), truth) > psnr(distorted, truth) - 0.01


def test_large_corrections_outweigh_a_wrong_alignment(affine: AffineRestorer) -> None:
    truth = smooth(120, 160, 6)
    distorted = np.clip(truth + np.array([0.2, -0.1, 0.1], np.float32), 0, 1)
    given = slanted(truth, distorted, bend=0.3)
    assert psnr(affine.restore(given), truth) > psnr(distorted, truth) + 2.5


def test_what_veils_the_reference_alone_is_not_corrected_away(affine: AffineRestorer) -> None:
    """A dark splat close to the reference's camera is among the client's splats, and not in the scene."""
    truth = smooth(120, 160, 6)
    distorted = np.clip(truth + 0.01 * (smooth(120, 160, 2, seed=1) - 0.5), 0, 1).astype(np.float32)
    given = inputs(truth, distorted)
    assert given.own is not None
    veiled = replace(given, own=replace(given.own, rgb=given.own.rgb - np.float32(0.02)))
    assert psnr(affine.restore(veiled), truth) > psnr(distorted, truth) - 1.5
    weak = np.clip(truth + 0.2 * (smooth(120, 160, 20, seed=1) - 0.5), 0, 1).astype(np.float32)
    given = inputs(truth, weak)
    assert given.own is not None
    veiled = replace(given, own=replace(given.own, rgb=given.own.rgb - np.float32(0.005)))
    assert psnr(affine.restore(veiled), truth) > psnr(weak, truth) + 3, "what is worth more than the veil stays"


def test_a_veil_that_is_the_smaller_part_costs_next_to_nothing(affine: AffineRestorer) -> None:
    """Two views of a sound scene differ on the average too: what a correction is worth is to stay."""
    truth = smooth(120, 160, 6)
    weak = np.clip(truth + 0.1 * (smooth(120, 160, 5, seed=1) - 0.5), 0, 1).astype(np.float32)
    plain = inputs(truth, weak)
    assert plain.own is not None
    trusting = AffineRestorer(AffineSettings(misregistration=0.0))
    veil = 0.5 * np.sqrt(np.square(trusting.restore(plain) - weak).mean())  # a quarter of the correction's power
    seen = replace(plain, distorted=(weak + veil).astype(np.float32))
    bare = trusting.restore(seen) - seen.distorted
    kept = affine.restore(seen) - seen.distorted
    assert np.square(kept).mean() > 0.85 * np.square(bare).mean()


def test_no_veil_is_looked_for_where_no_splat_makes_up_much_of_the_picture(affine: AffineRestorer) -> None:
    """Views of a scene of many splats that differ on the average are of its errors, and their correction stays."""
    truth = smooth(120, 160, 6)
    weak = np.clip(truth + 0.04 * (smooth(120, 160, 20, seed=1) - 0.5), 0, 1).astype(np.float32)
    given = inputs(truth, weak)
    assert given.own is not None
    seen = replace(given, distorted=(weak + np.float32(0.015)).astype(np.float32))
    change = {}
    for share in (0.01, 0.5, None):
        contribution = None if share is None else np.array([share, 0.01], np.float32) * given.own.alpha.size
        shown = replace(seen, own=replace(given.own, contribution=contribution))
        change[share] = np.square(affine.restore(shown) - shown.distorted).mean()
    assert change[0.01] > 4 * change[0.5]
    assert change[None] == change[0.5], "where nobody can tell, a veil is looked for"


def test_contributions_of_a_view_before_serve_one_that_was_drawn_without() -> None:
    given = inputs(smooth(120, 160, 6), smooth(120, 160, 6, seed=1))
    assert given.own is not None
    few = np.array([0.01, 0.01], np.float32) * given.own.alpha.size
    assert (given.veil, replace(given, contribution=few).veil) == (1.0, 0.0)
    assert replace(given, own=replace(given.own, contribution=50 * few), contribution=few).veil == 1.0
    assert replace(given, own=None, contribution=few).veil == 1.0


def test_corrections_beyond_what_may_be_wrong_are_left_out_where_they_are_everywhere(affine: AffineRestorer) -> None:
    truth = smooth(120, 160, 6)
    given = inputs(truth, np.clip(truth + 0.05, 0, 1).astype(np.float32))
    whole = affine.restore(given).copy()
    full = replace(given, expected=np.full((30, 40), 0.01, np.float32))
    anything = replace(given, expected=np.ones((30, 40), np.float32))
    assert np.abs(affine.restore(full) - given.distorted).max() < 0.005
    np.testing.assert_allclose(affine.restore(anything), whole, atol=2e-4)


@pytest.mark.parametrize("size", [(120, 160), (61, 83), (3, 5)])
def test_kernels_and_numpy_agree_on_what_the_alignment_gets_wrong(
    monkeypatch: pytest.MonkeyPatch, size: tuple[int, int]
) -> None:
    if not cags_kernels.native_available():
        pytest.skip(cags_kernels.why_unavailable())
    height, width = size
    camera = Camera(Intrinsics.of_fov(width, height, 1.0, 0.8), Pose((0.1, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)))
    depth = (1.5 + smooth(height, width, 4)[..., 0]).astype(np.float32)
    depth[: height // 4, : width // 3] = np.inf
    given = inputs(smooth(120, 160, 3), smooth(120, 160, 3, seed=1))
    aligned = create("fast").align(given.reference, depth, camera)
    alpha = np.ones(size, np.float32)
    case = RestoreInput(smooth(height, width, 2, seed=2), alpha, aligned, given.reference, given.own)
    native = AffineRestorer().restore(case).copy()
    monkeypatch.setattr(cags_kernels, "native_available", lambda: False)
    np.testing.assert_allclose(native, AffineRestorer().restore(case), atol=2e-4)


def test_the_correction_in_the_references_own_view_is_the_same_by_kernels_and_numpy(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    if not cags_kernels.native_available():
        pytest.skip(cags_kernels.why_unavailable())
    given = inputs(smooth(120, 160, 3), smooth(120, 160, 3, seed=1))
    assert given.own is not None
    native = corrected_there(given.own.rgb, given.reference, AffineSettings()).copy()
    assert np.abs(native - given.own.rgb).max() > 0.1
    monkeypatch.setattr(cags_kernels, "native_available", lambda: False)
    numpy = corrected_there(given.own.rgb, given.reference, AffineSettings())
    np.testing.assert_allclose(native, numpy, atol=2e-4)
