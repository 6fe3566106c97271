"""References of another media frame: what stands still keeps its correction, what moved is left alone."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import cags_kernels
from cags_bench.align.ages import COMINGS, AgeCase, AgedPlay, gains
from cags_client.align import ReferencePicture
from cags_client.carry import OnDisplay, ReferenceViews, carried, carried_as_defined
from cags_client.past import EarlierGroups
from cags_client.settings import ClientSettings
from cags_common import raster
from cags_common.bundle import BundleReader
from cags_common.geometry import Camera, Intrinsics, Pose
from cags_common.raster.base import RenderedView, RenderOptions
from cags_encoder import EncodeSettings, encode
from cags_encoder.scenes import open_scene

FRAMES = 31


@pytest.fixture(scope="module")
def reader(tmp_path_factory: pytest.TempPathFactory) -> BundleReader:
    folder: Path = tmp_path_factory.mktemp("bundle") / "room"
    settings = EncodeSettings(frames=FRAMES, train_splats=2048, lod_order="paper")
    encode(open_scene(f"procedural:size=3000,frames={FRAMES}"), settings, str(folder))
    return BundleReader.open(str(folder))


@pytest.fixture(scope="module")
def groups(tmp_path_factory: pytest.TempPathFactory) -> BundleReader:
    """Groups of two frames: every other frame sends all splats again, under new ids."""
    folder: Path = tmp_path_factory.mktemp("bundle") / "groups"
    settings = EncodeSettings(frames=7, gof_frames=2, train_splats=2048, lod_order="paper")
    encode(open_scene("procedural:size=3000,frames=7"), settings, str(folder))
    return BundleReader.open(str(folder))


@pytest.mark.skipif(not cags_kernels.native_available(), reason=cags_kernels.why_unavailable())
def test_a_reference_of_a_scene_in_which_nothing_has_changed_stays_as_it_is_to_the_bit():
    rng = np.random.default_rng(3)
    view = rng.random((37, 70, 3), np.float32)
    reference = np.clip(view + rng.normal(0, 0.05, view.shape), 0, 1).astype(np.float32)
    np.testing.assert_array_equal(carried(reference, view, view), reference)


def played(reader: BundleReader, case: AgeCase, **more: object) -> list[dict[str, float]]:
    client = ClientSettings(width=200, height=150, reference_age=60, **more)  # type: ignore[arg-type]
    return list(AgedPlay(reader, client, crf=20).play(case, [reader.manifest.frames - 1]))


@pytest.mark.parametrize("coming", COMINGS)
@pytest.mark.parametrize("age", [1, 3, 10, 30])
@pytest.mark.parametrize("lod", [0, 3, 9])
def test_a_late_reference_never_makes_a_frame_worse(reader: BundleReader, coming: str, age: int, lod: int) -> None:
    """The whole picture, and the pixels that move alone."""
    (record,) = played(reader, AgeCase(coming, age, lod, error_deg=2.0))
    assert record["moving"] > 0.01
    assert gains([record])[1] >= -0.1
    assert gains([record], "moving")[1] >= -0.2


@pytest.mark.parametrize("coming", COMINGS)
def test_what_stands_still_keeps_most_of_its_gain(reader: BundleReader, coming: str) -> None:
    fresh, old = (gains(played(reader, AgeCase(coming, age, 0)))[0] for age in (0, 3))
    assert old > 0.6 * fresh > 2.0


def test_a_late_reference_is_worth_as_much_as_one_that_was_held(reader: BundleReader) -> None:
    late, held = (gains(played(reader, AgeCase(coming, 3, 0)))[0] for coming in COMINGS)
    assert late == pytest.approx(held, abs=0.05)


@pytest.mark.parametrize("age", [1, 2, 5])
def test_a_reference_of_an_earlier_group_of_frames_keeps_its_worth(groups: BundleReader, age: int) -> None:
    assert len(groups.manifest.gof_starts) == 4
    late, held = (gains(played(groups, AgeCase(coming, age, 0))) for coming in COMINGS)
    assert late[0] == pytest.approx(held[0], abs=0.05)
    assert late[0] > 1.5


@pytest.mark.parametrize("lod", [0, 9])
def test_the_colour_adapter_does_not_learn_what_has_moved(reader: BundleReader, lod: int) -> None:
    (with_it,) = played(reader, AgeCase("late", 3, lod), adapt="sirt")
    (without,) = played(reader, AgeCase("late", 3, lod), adapt="none")
    for kind in ("covered", "moving"):
        assert with_it[f"psnr_{kind}_restored_db"] > without[f"psnr_{kind}_distorted_db"] - 0.1


def picture(seed: int, height: int, width: int, scale: float = 1.0) -> np.ndarray:
    return np.random.default_rng(seed).random((height, width, 3), np.float32) * np.float32(scale)


@settings(max_examples=40)
@given(st.integers(0, 99), st.integers(1, 40), st.integers(1, 40))
def test_carried_pictures(seed: int, height: int, width: int) -> None:
    reference, then, now = (picture(seed + i, height, width) for i in range(3))
    if height * width > 100:  # of a few pixels any may stand out
        np.testing.assert_allclose(carried(reference, then, then), reference, atol=1e-6)
    np.testing.assert_array_equal(carried(then, then, now), now)
    mixed = carried(reference, then, now)
    assert np.isfinite(mixed).all()
    assert 0 <= mixed.min() <= mixed.max() <= 1
    wrong = np.abs(mixed - now).mean()
    assert wrong <= np.abs(reference - then).mean()


@settings(max_examples=40)
@given(st.integers(0, 99), st.integers(1, 140), st.integers(1, 30), st.integers(1, 9), st.integers(1, 3))
def test_what_runs_is_what_is_defined(seed: int, width: int, height: int, age: int, threads: int) -> None:
    reference, then = (picture(seed + i, height, width, 1.2) - np.float32(0.1) for i in range(2))
    now = then.copy()
    now[: height // 2, width // 3 :] += picture(seed, height, width)[: height // 2, width // 3 :]
    defined = carried_as_defined(reference, then, now, age)
    np.testing.assert_allclose(carried(reference, then, now, age, threads), defined, atol=1e-4)


def test_a_cut_says_nothing_and_the_rest_of_a_picture_stays() -> None:
    then = np.full((40, 60, 3), 0.2, np.float32)
    reference, now = then + np.float32(0.02), then.copy()
    now[:, :20] = 0.9
    mixed = carried(reference, then, now)
    np.testing.assert_allclose(mixed[:, 30:], reference[:, 30:], atol=1e-6)
    assert np.abs(mixed - now)[:, :18].max() < 1e-4


@pytest.mark.parametrize("age", [1, 4, 16])
def test_a_correction_that_stands_out_is_of_something_that_was_not_sent(age: int) -> None:
    """The splats are as they were, but a part of the reference shows what they cannot: it has moved meanwhile."""
    then = np.full((60, 80, 3), 0.3, np.float32)
    reference = then + np.random.default_rng(0).normal(0, 0.02, then.shape).astype(np.float32)
    reference[20:40, 20:40] = 0.95
    mixed = carried(reference, then, then, age)
    np.testing.assert_allclose(mixed[:, 50:], reference[:, 50:], atol=1e-6)
    assert np.abs(mixed - then)[25:35, 25:35].max() < 0.2 / age


def test_contributions_are_counted_once_a_reference() -> None:
    """They weigh a figure of the report; the client's own view is drawn anew with every change of the splats."""
    counted: list[bool] = []

    class Scene:
        def render(self, camera: Camera, options: RenderOptions) -> RenderedView:
            counted.append(options.contribution)
            blank = np.zeros((camera.height_px, camera.width_px, 3), np.float32)
            return RenderedView(blank, blank[..., 0], None, np.ones(1, np.float32) if options.contribution else None)

    past = SimpleNamespace(knows=lambda _: False, changed_since=lambda _: True)
    views = ReferenceViews(raster.create("reference"), EarlierGroups())
    camera = Camera(Intrinsics.of_fov(8, 6, 1.0, 0.8), Pose.identity())
    references = [ReferencePicture(picture(i, 6, 8), camera, frame=i) for i in range(2)]
    for changes, which in enumerate((0, 0, 0, 1, 1)):
        held = OnDisplay(Scene(), SimpleNamespace(past=past), changes, 0, lambda _: None)  # type: ignore[arg-type]
        views.now(references[which], held, RenderOptions())
    assert counted == [True, False, False, True, False]
