"""The client's whole frame and the server's reference on the device, against the readable definition."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cags_common.correction import Corrected, CorrectSettings, Reference, veto_shape
from cags_common.correction.compander import ZERO
from cags_common.correction.oracle import correct
from cags_common.geometry import Camera, Pose
from cags_common.raster import DepthKind, Footprint
from cags_common.splats import Splats
from cags_gpu.correct import corrected, shown
from cags_gpu.keeper import Keeper
from cags_gpu.raster import GpuRasteriser
from support.device_frames import CLIENT, EXACT, SERVER, lack, plates, reference, share_within
from support.gpu import any_gpu, needs_adapter, rasteriser
from support.raster_scenes import F, random_splats, splat


def by_definition(
    splats: Splats, ref: Reference, settings: CorrectSettings | None = None, veto: np.ndarray | None = None
) -> Corrected:
    """Corrected from the device's own rendering: a z-test may hang on the last bit of a depth."""
    scene = rasteriser().load(splats)
    own = None
    if ref.picture:
        footprint = Footprint.of(CLIENT.intrinsics, ref.camera.intrinsics)
        own = scene.render(ref.camera, replace(EXACT, footprint=footprint, depth=DepthKind.NONE)).rgb
    return correct(scene.render(CLIENT, EXACT), CLIENT, ref, own, settings, veto=veto)


@needs_adapter
@pytest.mark.parametrize("picture", [False, True], ids=["difference", "picture"])
@pytest.mark.parametrize("border", [0.0, 3.0])
def test_the_frame_is_the_definitions(picture: bool, border: float) -> None:
    splats, settings = plates(), CorrectSettings(border_px=border)
    coded = np.clip(0.5 + lack(), 0, 1).astype(F) if picture else reference().coded
    ref = reference(coded=coded, picture=picture)
    right = by_definition(splats, ref, settings)
    ours = corrected(rasteriser().load(splats), CLIENT, EXACT, ref, settings)
    assert (right.confidence == 0).mean() > 0.01, "the case has pixels that nothing is added to"
    assert (right.confidence > 0).mean() > 0.5
    assert share_within(ours.rgb, right.rgb) >= 0.9999
    assert (np.abs(ours.confidence - right.confidence) > 1e-3).mean() <= 1e-3


@needs_adapter
def test_a_veto_and_holes_beyond_the_reference_are_the_definitions() -> None:
    wall = plates()
    splats = wall.take(np.flatnonzero(wall.means[:, 0] < 0.3))
    aside = replace(SERVER, pose=Pose.looking_at((0.9, 0.3, -4.7), (-1.2, 0.0, 0.0), (0.0, 1.0, 0.0)))
    ref = Reference(reference().coded, aside)
    free = None
    for shape in (None, veto_shape(CLIENT), (64, 96), None):
        veto = None if shape is None else np.random.default_rng(1).random(shape, dtype=F)
        right = by_definition(splats, ref, veto=veto)
        ours = corrected(rasteriser().load(splats), CLIENT, EXACT, ref, veto=veto)
        assert share_within(ours.rgb, right.rgb) >= 0.999
        assert (np.abs(ours.confidence - right.confidence) > 1e-3).mean() <= 1e-3
        free = right if free is None else free
        assert veto is None or (right.confidence < free.confidence - 0.1).mean() > 0.3
    assert free is not None
    narrow = by_definition(splats, ref, CorrectSettings(hole_alpha=0.0, border_px=0.0))
    assert ((free.confidence > 0.5) & (narrow.confidence == 0)).mean() > 0.05, "holes beyond the reference"
    with pytest.raises(ValueError, match="veto of shape"):
        corrected(rasteriser().load(splats), CLIENT, EXACT, ref, veto=np.zeros((3, 3), F))


@needs_adapter
def test_codes_of_the_whole_range_and_beyond_are_the_definitions() -> None:
    splats = plates()
    coded = np.random.default_rng(6).choice(np.array([-0.5, 0.0, ZERO, ZERO + 5e-6, 0.503, 1.0, 1.5], F), (36, 48, 3))
    for knee in (0.01, 0.15, 1.0):
        ref = reference(coded=coded, knee=knee)
        right, ours = by_definition(splats, ref), corrected(rasteriser().load(splats), CLIENT, EXACT, ref)
        assert share_within(ours.rgb, right.rgb) >= 0.9999


@needs_adapter
def test_bytes_shown_are_the_floats_rounded_and_opaque() -> None:
    scene = rasteriser().load(plates())
    floats, levels = corrected(scene, CLIENT, EXACT, reference()), shown(scene, CLIENT, EXACT, reference())
    assert levels.shape == (64, 96, 4)
    assert (levels[..., 3] == 255).all()
    assert np.abs(levels[..., :3] - floats.rgb.astype(np.float64) * 255).max() <= 0.5 + 1e-3


@needs_adapter
def test_nothing_lacking_changes_nothing_and_no_reference_is_the_drawing() -> None:
    scene = rasteriser().load(plates())
    drawn = np.clip(scene.render(CLIENT, EXACT).rgb, 0, 1)
    none = corrected(scene, CLIENT, EXACT, None)
    np.testing.assert_array_equal(none.rgb, drawn)
    assert not none.confidence.any()
    grey = corrected(scene, CLIENT, EXACT, reference(coded=np.full((36, 48, 3), ZERO, F)))
    np.testing.assert_array_equal(grey.rgb, drawn)
    assert shown(scene, CLIENT, EXACT, None).shape == (64, 96, 4)


@needs_adapter
def test_a_reference_is_expanded_once_and_a_picture_again_when_splats_change() -> None:
    splats = plates()
    scene = rasteriser().load(splats)
    difference, picture = reference(), reference(coded=np.full((36, 48, 3), 0.6, F), picture=True)
    turned = CLIENT.at(Pose((0.2, 0.0, -5.0), CLIENT.pose.rotation))
    for ref in (difference, difference, picture, picture, difference, reference(coded=difference.coded * F(0.9))):
        for cam in (CLIENT, turned):
            fresh = rasteriser().load(splats)
            ours, right = (corrected(s, cam, EXACT, ref).rgb for s in (scene, fresh))
            np.testing.assert_array_equal(ours, right)
    corrected(scene, CLIENT, EXACT, picture)
    splats.sh0[:100] = 0
    scene.update(np.arange(100), splats)
    fresh = rasteriser().load(splats)
    np.testing.assert_array_equal(*(corrected(s, CLIENT, EXACT, picture).rgb for s in (scene, fresh)))


@needs_adapter
def test_a_client_without_splats_sees_what_the_reference_shows() -> None:
    picture = reference(coded=np.full((36, 48, 3), 0.7, F), picture=True)
    for splats in (random_splats(0), splat((0.0, 0.0, -40.0))):  # none; one behind the camera
        out = corrected(rasteriser().load(splats), CLIENT, EXACT, picture)
        np.testing.assert_allclose(out.rgb[out.confidence == 1], 0.7, atol=1e-5)
        assert (out.confidence == 1).mean() > 0.5


@needs_adapter
def test_an_identity_returns_the_reference() -> None:
    splats = plates()
    there = Camera(CLIENT.intrinsics, CLIENT.pose)
    truth = np.random.default_rng(5).random((64, 96, 3), dtype=F)
    out = corrected(
        rasteriser().load(splats), CLIENT, EXACT, Reference(truth, there, picture=True), CorrectSettings(border_px=0)
    )
    np.testing.assert_allclose(out.rgb, truth, atol=2e-5)


@needs_adapter
def test_without_a_device_the_definition_draws(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cags_gpu.keeper.FIRST_DELAY_S", 60.0)
    own = Keeper(any_gpu)
    scene = GpuRasteriser(own).load(plates())
    before = corrected(scene, CLIENT, EXACT, reference())
    own.current().gpu.destroy()
    after = corrected(scene, CLIENT, EXACT, reference())
    assert own.current() is None
    assert share_within(after.rgb, before.rgb) >= 0.999
    assert np.abs(shown(scene, CLIENT, EXACT, reference())[..., :3] / 255.0 - after.rgb).max() <= 0.5 / 255 + 1e-6
    own.close()
