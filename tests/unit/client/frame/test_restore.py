"""What is done with references: restorers of aligned pictures, and what can be asked for and changed to."""

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest

from cags_client.frame import restore
from cags_client.frame.align import ReferencePicture, create
from cags_client.frame.restore import (
    CORRECT,
    NONE,
    RESTORERS,
    RestoreInput,
    expected_psnr_db,
    references_wanted,
    switchable,
)
from cags_client.frame.restore.base import TYPICAL_BASE_DB, TYPICAL_TOP_DB
from cags_common.bundle.manifest import Manifest
from cags_common.errors import ConfigError
from cags_common.geometry import Camera, Intrinsics, Pose
from cags_common.tiles.lod import LodLayer

LARGE = Intrinsics.of_fov(160, 120, 1.0, 0.8)
SMALL = Intrinsics.of_fov(40, 30, 1.0, 0.8)
CAMERA = Camera(LARGE, Pose.identity())
OF_PICTURES = RESTORERS.names()


def smooth(height: int, width: int, sigma: float, seed: int = 0) -> np.ndarray:
    noise = np.random.default_rng(seed).random((height, width, 3)).astype(np.float32)
    picture = cv2.GaussianBlur(noise, (0, 0), sigma)
    return (picture - picture.min()) / (picture.max() - picture.min())


def inputs(truth: np.ndarray, distorted: np.ndarray) -> RestoreInput:
    """The same view from the same pose, on a flat wall."""
    small = cv2.resize(truth, (40, 30), interpolation=cv2.INTER_AREA)
    reference = ReferencePicture(small, Camera(SMALL, Pose.identity()), 0)
    return RestoreInput(distorted, create("fast").align(reference, np.full((120, 160), 2.0, np.float32), CAMERA), 0.0)


@pytest.mark.parametrize("name", OF_PICTURES)
@pytest.mark.parametrize("fill", [0.0, 1.0])
def test_pictures_stay_finite_and_in_range(name: str, fill: float) -> None:
    distorted = smooth(120, 160, 1)
    before = distorted.copy()
    restored = restore.create(name).restore(inputs(np.full((120, 160, 3), fill, np.float32), distorted))
    assert restored.shape == distorted.shape
    assert np.isfinite(restored).all()
    assert restored.min() >= 0
    assert restored.max() <= 1
    np.testing.assert_array_equal(distorted, before)


def test_reference_shows_the_aligned_picture_and_the_clients_own_where_it_says_nothing() -> None:
    given = inputs(smooth(120, 160, 4), smooth(120, 160, 4, seed=1))
    confidence = given.aligned.confidence.copy()
    confidence[:, :80] = 0
    shown = restore.create("reference").restore(replace(given, aligned=replace(given.aligned, confidence=confidence)))
    np.testing.assert_array_equal(shown[:, :80], given.distorted[:, :80])
    inside = confidence == 1
    assert inside.any()
    np.testing.assert_allclose(shown[inside], given.aligned.rgb[inside], atol=1e-6)


def info(*gains_db: float, base_db: float | None = None, levels: int | None = None) -> Manifest:
    """What a client knows of a ladder whose levels win ``gains_db``, or of one of ``levels`` that was not measured."""
    order = (LodLayer("scale", 1),) * (len(gains_db) if levels is None else levels)
    flat = ((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))
    return Manifest("", 30.0, 1, (0,), (1,), 0, flat, order, gains_db, base_psnr_db=base_db)


@pytest.mark.parametrize(
    ("lod_mean", "gains_db", "expected_db"),
    [
        (0.0, (12.0, 6.0, 2.0), 30),
        (0.5, (12.0, 6.0, 2.0), 36),
        (1.0, (12.0, 6.0, 2.0), 42),
        (3.0, (12.0, 6.0, 2.0), 50),
        (1.0, (10.0, -1.0, 10.0), 40),
        (2.0, (10.0, -1.0, 10.0), 40),
        (math.nan, (12.0, 6.0, 2.0), 0),
        (0.0, (), 51),
    ],
)
def test_what_is_expected_is_what_the_encoder_measured(
    lod_mean: float, gains_db: tuple[float, ...], expected_db: float
) -> None:
    assert expected_psnr_db(lod_mean, info(*gains_db, base_db=30.0)) == pytest.approx(expected_db)


@pytest.mark.parametrize("gains_db", [(), (0.0,) * 16])
def test_where_nothing_was_measured_typical_values_are_expected(gains_db: tuple[float, ...]) -> None:
    for lod, share in ((0, 0.0), (1, 0.25), (4, 0.5), (16, 1.0)):
        found = expected_psnr_db(lod, info(*gains_db, levels=16))
        assert found == TYPICAL_BASE_DB + share * (TYPICAL_TOP_DB - TYPICAL_BASE_DB)


@pytest.mark.parametrize("name", ["magic", "magic@torch", "", "@torch"])
def test_an_unknown_restorer_is_named(name: str) -> None:
    for asked in (restore.create, restore.check_name):
        with pytest.raises(ConfigError, match=f"'{name}' is unknown; known: correct, none"):
            asked(name)


def test_a_runtime_is_for_networks_alone() -> None:
    with pytest.raises(ConfigError, match="'reference' runs no network: leave '@torch' out"):
        restore.create("reference@torch")


@pytest.mark.parametrize("name", [CORRECT, NONE])
def test_what_works_on_no_aligned_picture_is_not_made(name: str) -> None:
    restore.check_name(name)
    with pytest.raises(ConfigError, match=f"'{name}' works on no aligned picture; these do: cr-no-ref, reference"):
        restore.create(name)


@pytest.mark.parametrize(
    ("name", "wanted"), [("correct", "any"), ("none", "none"), ("reference", "picture"), ("srresnet@cuda", "picture")]
)
def test_a_client_asks_for_what_it_can_use(name: str, wanted: str) -> None:
    assert references_wanted(name) == wanted


@pytest.mark.parametrize("began", [CORRECT, NONE, *OF_PICTURES, "srresnet@torch"])
def test_a_viewer_changes_only_to_what_can_use_the_references_that_come(began: str) -> None:
    choices = switchable(began)
    assert choices[0] == began
    assert len(set(choices)) == len(choices)
    comes = references_wanted(began)
    for choice in choices:
        restore.check_name(choice)
        assert choice in (NONE, CORRECT) or references_wanted(choice) == comes
        assert choice != CORRECT or comes != "none"
