"""Veils: what one splat close to a camera does to its picture is told from what is wrong with the scene."""

from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cags_client.carry import OnDisplay
from cags_client.expected import Veils
from cags_client.restore.veil import CERTAIN, STARTS, plausible, suspicion
from cags_common import raster
from cags_common.geometry import Camera, Intrinsics, Pose
from cags_common.raster.base import RenderOptions
from cags_common.splats import Splats
from cags_common.store.shown import Shown

CAMERA = Camera(Intrinsics.of_fov(64, 48, 1.0, 0.8), Pose.identity())
GAINS_DB = (6.0, 14.0)
"""Three LoDs: errors of 1, a half and a tenth."""


def offsets(change: np.ndarray) -> np.ndarray:
    """Fields [h, w, 4] that add ``change`` [h, w, 3] to any picture."""
    return np.concatenate([np.zeros((*change.shape[:2], 1)), change], axis=2).astype(np.float32)


def scene_of(depths: list[float], sizes: list[float], lods: list[int]) -> OnDisplay:
    """Opaque round splats on the camera's axis, one a tile."""
    n = len(depths)
    means = np.zeros((n, 3), np.float32)
    means[:, 2] = depths
    quats = np.tile(np.array([1, 0, 0, 0], np.float32), (n, 1))
    scales = np.log(np.repeat(np.array(sizes, np.float32)[:, None], 3, axis=1))
    rest = np.ones((n, 3, 3), np.float32)
    splats = Splats(means, quats, scales, np.full(n, 8.0, np.float32), np.zeros((n, 3), np.float32), rest)
    tiles = tuple(SimpleNamespace(shown_lod=lod) for lod in lods)
    store = SimpleNamespace(splats=splats, shown=Shown(np.arange(n, dtype=np.int32), tiles))  # type: ignore[arg-type]
    return OnDisplay(None, store, 0)  # type: ignore[arg-type]


@given(st.lists(st.floats(0, 1), min_size=1, max_size=20))
def test_suspicion_is_that_of_the_largest_share(shares: list[float]) -> None:
    found = suspicion(np.array(shares, np.float32) * np.float32(100), 100)
    expected = np.clip((max(shares) - STARTS) / (CERTAIN - STARTS), 0, 1)
    assert found == pytest.approx(expected, abs=1e-4)


def test_nobody_knows_of_veils_without_contributions_and_nothing_veils_an_empty_scene() -> None:
    assert suspicion(None, 100) == 1.0
    assert suspicion(np.zeros(0, np.float32), 100) == 0.0


def test_a_correction_of_what_is_at_full_lod_almost_everywhere_is_a_veils() -> None:
    own = np.full((48, 64, 3), 0.4, np.float32)
    expected = np.full((48, 64), 0.01, np.float32)
    expected[10:30, 20:40] = 0.5
    fields = offsets(np.full((48, 64, 3), 0.03))
    kept = plausible(fields, own, own + np.float32(0.03), expected)
    assert np.abs(kept[:, 48:]).max() < 0.001
    np.testing.assert_allclose(kept[14:26, 24:36], fields[14:26, 24:36], rtol=1e-3)


@pytest.mark.parametrize("share", [0.1, 0.25])
def test_parts_that_are_missing_are_corrected_though_all_is_at_full_lod(share: float) -> None:
    """Of what has not been sent no LoD tells."""
    own = np.full((48, 64, 3), 0.4, np.float32)
    change = np.zeros((48, 64, 3), np.float32)
    change[:, : round(64 * share)] = 0.3
    fields = offsets(change)
    assert plausible(fields, own, own + change, np.full((48, 64), 0.01, np.float32)) is fields


def test_what_may_be_wrong_stays_however_much_of_the_picture_it_is() -> None:
    rng = np.random.default_rng(1)
    own = rng.random((48, 64, 3)).astype(np.float32)
    change = 0.1 * cv2.GaussianBlur(rng.standard_normal((48, 64, 3)), (0, 0), 2)
    fields = offsets(change)
    assert plausible(fields, own, own + fields[..., 1:], np.full((48, 64), 0.5, np.float32)) is fields


def test_void_is_no_part_of_the_picture() -> None:
    """An object of a tenth of the picture, all of it veiled."""
    own = np.zeros((48, 64, 3), np.float32)
    own[16:32, 20:40] = 0.4
    change = np.where(own > 0, np.float32(0.05), np.float32(0))
    kept = plausible(offsets(change), own, own + change, np.full((48, 64), 0.01, np.float32))
    assert np.abs(kept).max() < 0.01


def test_pictures_of_nothing_stay_finite() -> None:
    nothing = np.zeros((3, 5, 3), np.float32)
    fields = offsets(np.full((3, 5, 3), 0.5))
    assert np.isfinite(plausible(fields, nothing, nothing, np.zeros((3, 5), np.float32))).all()


def test_expected_errors_are_those_of_the_splats_that_are_seen() -> None:
    """A small splat of the lowest LoD before a large one of the highest."""
    held = scene_of([2.0, 4.0], [0.1, 3.0], [0, 2])
    rasteriser = raster.create("auto")
    errors = Veils(rasteriser, GAINS_DB).expected(CAMERA, held, RenderOptions())
    view = rasteriser.load(held.store.splats).render(CAMERA, RenderOptions())
    assert errors is not None
    assert errors.shape == (48, 64)
    assert errors[24, 32] == pytest.approx(1.0, abs=0.04)
    assert errors[24, 8] == pytest.approx(0.1 * view.alpha[24, 8], abs=0.002)


def test_nothing_is_told_apart_where_all_is_of_one_lod_or_no_gains_are_known() -> None:
    def expected(held: OnDisplay, gains_db: tuple[float, ...] = GAINS_DB) -> np.ndarray | None:
        return Veils(raster.create("auto"), gains_db).expected(CAMERA, held, RenderOptions())

    assert expected(scene_of([2.0, 4.0], [0.1, 3.0], [1, 1])) is None
    assert expected(scene_of([2.0, 4.0], [0.1, 3.0], [0, 1]), ()) is None
    assert expected(scene_of([], [], [])) is None


def test_gains_that_make_no_sense_give_errors_between_0_and_1() -> None:
    held = scene_of([2.0, 4.0], [0.1, 3.0], [1, 2])
    errors = Veils(raster.create("auto"), (-1e3, 2e3)).expected(CAMERA, held, RenderOptions())
    assert errors is not None
    assert np.isfinite(errors).all()
    assert errors.min() >= 0
    assert errors.max() <= 1 + 1e-5


def test_expected_errors_are_drawn_once_for_a_camera_and_a_state_of_the_scene() -> None:
    held = scene_of([2.0, 4.0], [0.1, 3.0], [0, 2])
    veils = Veils(raster.create("auto"), GAINS_DB)
    first = veils.expected(CAMERA, held, RenderOptions())
    assert veils.expected(CAMERA, held, RenderOptions()) is first
    changed = OnDisplay(held.scene, held.store, 1, 0, held.restore)
    assert veils.expected(CAMERA, changed, RenderOptions()) is not first
