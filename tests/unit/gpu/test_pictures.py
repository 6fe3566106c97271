"""A client's frame made on the device: one picture comes back, the others when somebody looks at them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cags_common.correction import Correction, FrameScene, Reference, Spheres
from cags_common.geometry import Camera
from cags_common.raster import DepthKind, Exactness, RenderOptions
from cags_common.raster.halving import enlarged, halved
from cags_gpu import submission
from cags_gpu.correct import Frame
from cags_gpu.keeper import Keeper
from cags_gpu.pictures import DevicePictures
from cags_gpu.raster import GpuRasteriser, GpuScene
from cags_gpu.workspace import Workspace
from support.device_frames import CLIENT, EXACT, SERVER, by_definition, lack, plates, reference, share_within
from support.gpu import any_gpu, needs_adapter, rasteriser
from support.raster_scenes import F, camera, psnr_db

pytestmark = needs_adapter

DISPLAYED = replace(EXACT, displayed=True)


def picture(error: float = 0.0) -> Reference:
    return reference(coded=np.clip(0.5 + lack(), 0, 1).astype(F), picture=True, error=error)


def given(ref: Reference, **changed: object) -> Correction:
    return replace(Correction(ref, CLIENT.intrinsics), **changed)


def made(
    scene: GpuScene,
    correction: Correction | None,
    seen_by: Camera = CLIENT,
    display: Camera | None = None,
    options: RenderOptions = DISPLAYED,
) -> DevicePictures:
    out = scene.frame(seen_by, options, correction, display)
    assert out is not None
    return out


def discs(count: int, z: float) -> Spheres:
    """Balls over the left half of the view, ``z`` in the world."""
    rng = np.random.default_rng(4)
    positions = np.stack([rng.uniform(-1.5, 0, count), rng.uniform(-1, 1, count), np.full(count, z)], axis=1)
    return Spheres(positions.astype(F), np.full(count, 0.1, F))


@pytest.mark.parametrize("error", [0.0, 1e-3, 1e-2])
def test_a_picture_is_trusted_as_far_as_by_the_definition(error: float) -> None:
    scene, correction = rasteriser().load(plates()), given(picture(error))
    right, ours = by_definition(scene, CLIENT, DISPLAYED, correction), made(scene, correction)
    assert share_within(ours.rgb, right.rgb) >= 0.9999
    sure = by_definition(scene, CLIENT, DISPLAYED, given(picture()))
    assert error == 0 or not np.allclose(right.rgb, sure.rgb, atol=0.01), "the case hangs on the trust"


@pytest.mark.parametrize(("z", "seen"), [(-2.2, True), (2.5, False)], ids=["before", "behind"])
@pytest.mark.parametrize("stale", [0.0, 0.4])
def test_what_changed_and_is_seen_is_left_as_it_is_drawn(z: float, seen: bool, stale: float) -> None:
    scene = rasteriser().load(plates())
    correction = given(reference(), changed=discs(7, z), stale=stale)
    right, ours = by_definition(scene, CLIENT, DISPLAYED, correction), made(scene, correction)
    assert share_within(ours.rgb, right.rgb) >= 0.9999
    assert ours.confidence is not None
    assert np.abs(ours.confidence - right.confidence).max() <= 1 / 255
    free = by_definition(scene, CLIENT, DISPLAYED, given(reference()))
    vetoed = (right.confidence < 0.5 * free.confidence).mean()
    assert (vetoed > 0.05) == seen


def test_any_number_of_splats_may_have_changed_and_none() -> None:
    scene = rasteriser().load(plates())
    for count in (0, 1, 300, 3000, 2):
        correction = given(reference(), changed=discs(count, -2.2))
        right, ours = by_definition(scene, CLIENT, DISPLAYED, correction), made(scene, correction)
        assert share_within(ours.rgb, right.rgb) >= 0.9999


@pytest.mark.parametrize("size", [(1, 1), (16, 16), (17, 33), (130, 7)])
def test_views_of_any_size_are_compared_and_vetoed(size: tuple[int, int]) -> None:
    seen_by, scene = camera(*size), rasteriser().load(plates())
    correction = given(picture(1e-3), changed=discs(5, -2.2), stale=0.2)
    right = by_definition(scene, seen_by, DISPLAYED, correction)
    assert share_within(made(scene, correction, seen_by).rgb, right.rgb) >= 0.99


def test_a_frame_of_half_the_pixels_is_brought_up() -> None:
    scene = rasteriser().load(plates())
    for display in (CLIENT, camera(95, 63)):
        half = halved(display)
        for correction in (None, given(reference())):
            ours = made(scene, correction, half, display)
            small = made(scene, correction, half)
            assert (ours.size, ours.rgb.shape) == ((32, 48), (display.height_px, display.width_px, 3))
            right = enlarged(small.rgb, display, 1)
            assert np.abs(ours.rgb - right).max() <= 2.5 / 255, "of colours that were not rounded in between"
            assert np.abs(ours.rgb - right).mean() <= 0.6 / 255
            if correction is not None:
                assert small.confidence is not None
                np.testing.assert_array_equal(ours.confidence, small.confidence)


@pytest.mark.parametrize("level", [Exactness.BALANCED, Exactness.FAST])
@pytest.mark.parametrize("corrected", [None, "difference", "picture"])
def test_pictures_for_a_display_are_kept_in_16_bits_and_shown_as_floats_are(
    level: Exactness, corrected: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    options = replace(DISPLAYED, exactness=level)
    splats = plates()
    scene = rasteriser().load(replace(splats, sh0=splats.sh0 * 3))  # some brighter than a display
    correction = None if corrected is None else given(picture(1e-3) if corrected == "picture" else reference())
    ours = made(scene, correction, options=options)
    drawn, alpha = ours.drawn, ours.alpha
    monkeypatch.setattr(Frame, "compact", False)
    floats = made(scene, correction, options=options)
    assert 0.9 < floats.drawn.max() <= 1
    for compact, whole in ((drawn, floats.drawn), (alpha, floats.alpha)):
        assert np.abs(compact - whole).max() <= 0.5001 / 65535
        assert (compact != whole).any(), "16 bits are fewer than a float's"
    off = np.abs(ours.rgb - floats.rgb)
    assert off.max() <= 1.0001 / 255
    assert (off > 0).mean() <= 0.01, "only what lies next to a level's edge is shown a level off"
    assert psnr_db(drawn, floats.drawn) >= 100


def test_of_an_exact_frame_no_bit_is_lost() -> None:
    scene = rasteriser().load(plates())
    right = scene.render(CLIENT, DISPLAYED)
    ours = made(scene, None)
    np.testing.assert_array_equal(ours.drawn, right.rgb)
    np.testing.assert_array_equal(ours.alpha, right.alpha)


def test_nothing_comes_back_but_the_picture_until_it_is_looked_at(monkeypatch: pytest.MonkeyPatch) -> None:
    read: list[int] = []
    real = submission._submit

    def counted(workspace: Workspace, recording: submission.Recording, wanted: submission.Outputs) -> object:
        read.append(sum(output.size for output in wanted))
        return real(workspace, recording, wanted)

    monkeypatch.setattr(submission, "_submit", counted)
    scene, correction = rasteriser().load(plates()), given(picture(), changed=discs(9, -2.2))
    ours = made(scene, correction)
    assert ours.rgb.shape == (64, 96, 3)
    assert ours.confidence is not None
    pixels, state = 64 * 96, 16
    assert read == [state + 4 * pixels]
    assert ours.drawn.shape == (64, 96, 3)
    assert ours.alpha.shape == (64, 96)
    assert ours.depth is not None
    assert read[1:] == [16 * pixels, 4 * pixels]


def test_what_is_looked_at_late_is_what_was_drawn() -> None:
    splats = plates()
    scene = rasteriser().load(splats)
    views = []
    for _ in range(3):
        scene.update(np.arange(len(splats)), splats)
        views.append((made(scene, given(reference())), scene.render(CLIENT, DISPLAYED).rgb))
        splats.sh0[:] += F(0.2)
    for late, then in views:
        np.testing.assert_array_equal(late.drawn, then)
    assert not np.allclose(views[0][1], views[2][1], atol=0.05)


def test_buffers_nobody_looks_at_are_used_again() -> None:
    scene = rasteriser().load(plates())
    kept = [made(scene, None) for _ in range(3)]
    roles = {made(scene, None)._target for _ in range(5)}
    assert len(roles) == 1
    assert roles.isdisjoint({each._target for each in kept})


def test_a_plain_frame_has_depth_where_it_was_asked_for() -> None:
    scene = rasteriser().load(plates())
    whole = made(scene, None)
    assert whole.confidence is None
    np.testing.assert_array_equal(whole.depth, scene.render(CLIENT, DISPLAYED).depth)
    flat = made(scene, None, options=replace(DISPLAYED, depth=DepthKind.NONE))
    assert flat.depth is None
    np.testing.assert_array_equal(flat.rgb, whole.rgb)


def test_after_a_loss_frames_are_made_step_by_step_and_old_ones_drawn_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cags_gpu.keeper.FIRST_DELAY_S", 60.0)
    own = Keeper(any_gpu)
    scene = GpuRasteriser(own).load(plates())
    assert isinstance(scene, FrameScene)
    old = made(scene, None)
    own.current().gpu.destroy()  # type: ignore[union-attr]
    assert np.abs(old.drawn - old.rgb).max() <= 0.5 / 255 + 1e-4
    assert old.depth is not None
    assert scene.frame(CLIENT, DISPLAYED, given(reference())) is None
    own.close()


def test_entries_that_overflow_under_a_picture_show_nothing_wrong() -> None:
    """The client's render from the reference camera overflows, too: what was made of it then counts no more."""
    small = Keeper(any_gpu)
    workspace = small.current()
    assert workspace is not None
    scene, right = GpuRasteriser(small).load(plates()), rasteriser().load(plates())
    scene.on_device(lambda resident: resident, lambda _: None)
    workspace.counts["capacity"] = 64
    workspace.version += 1
    workspace._buffers.clear()
    correction = given(picture())
    for _ in range(2):
        np.testing.assert_array_equal(made(scene, correction).rgb, made(right, correction).rgb)
    assert workspace.counts["capacity"] > 64
    small.close()


def test_a_scene_without_splats_is_drawn_step_by_step() -> None:
    empty = rasteriser().load(plates().take(np.zeros(0, np.intp)))
    assert empty.frame(CLIENT, DISPLAYED, None) is None
    assert empty.render(SERVER, DISPLAYED).alpha.max() == 0
