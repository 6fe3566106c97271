"""The readable definition of the correction: its parts by themselves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cags_common.correction import CorrectSettings, Placement, Reference, compand
from cags_common.correction.base import FAR
from cags_common.correction.oracle import correct, filled, lacking
from cags_common.geometry import Camera
from cags_common.raster import RenderedView
from support.corrections import F, camera, difference, flat_view, picture

CLIENT = camera((96, 64))
SERVER = camera((48, 36), fov_rad=1.3, at=(0.4, 0.1, -0.2), turned_rad=0.1)


def test_holes_take_the_depth_around_them_and_an_empty_view_is_far() -> None:
    depth = np.full((40, 56), 2.0)
    depth[8:24, 16:40] = np.inf
    np.testing.assert_allclose(filled(depth), 2.0, rtol=1e-9)
    assert (filled(np.full((9, 9), np.inf)) == FAR).all()


def test_depths_that_no_scene_has_are_holes_or_far() -> None:
    depth = np.full((16, 16), 2.0)
    depth[0, :4] = 0.0, -1.0, 1e-9, np.nan
    depth[1, 0] = 1e30
    out = filled(depth)
    np.testing.assert_allclose(out[0, :4], 2.0, rtol=0.1)
    assert out[1, 0] == FAR


def test_a_placement_is_the_projection_of_points() -> None:
    m = Placement(CLIENT, SERVER).matrix
    u, v, depth = 31.5, 40.25, 4.2
    ray = np.array([(u - 48) / CLIENT.intrinsics.fx_px, (v - 32) / CLIENT.intrinsics.fy_px, 1.0]) * depth
    world = CLIENT.pose.rotation_matrix @ ray + np.asarray(CLIENT.pose.position)
    rotation, shift = SERVER.world_to_camera
    seen = rotation @ world + shift
    x, y, z = m @ np.array([u * depth, v * depth, depth, 1.0])
    i = SERVER.intrinsics
    assert z == pytest.approx(seen[2])
    assert (x / z, y / z) == pytest.approx(
        (seen[0] / seen[2] * i.fx_px + i.cx_px, seen[1] / seen[2] * i.fy_px + i.cy_px)
    )


def test_what_a_nearer_surface_hides_is_left_alone() -> None:
    """A wall behind a plate: seen from the side, the plate covers wall that the client sees beside it."""
    server = camera((96, 64), at=(0.5, 0.0, 0.0))
    wall = flat_view(CLIENT, 4.0)
    depth = np.full((64, 96), 4.0, F)
    depth[:, 40:56] = 1.5
    view = replace(wall, depth=depth)
    coded = np.full((64, 96, 3), compand(np.array([0.3]), 0.1)[0], F)
    out = correct(view, CLIENT, Reference(coded, server), settings=CorrectSettings(border_px=0))
    shift_px = (
        0.5 * CLIENT.intrinsics.fx_px * (1 / 1.5 - 1 / 4.0)
    )  # of the plate against the wall, between the two views
    first = int(40 - shift_px) + 2
    assert first < 30
    assert (out.confidence[:, first:38] == 0).all(), "wall behind the plate as the server sees it"
    assert (out.confidence[:, 42:54] == 1).all(), "the plate itself"
    assert (out.confidence[:, 12 : first - 4] == 1).all(), "wall beside it"
    np.testing.assert_allclose(out.rgb[out.confidence == 1], 0.8, atol=1e-5)
    np.testing.assert_allclose(out.rgb[:, first:38], 0.8, atol=1e-5)  # a guess: as the wall and the plate beside it


def test_hidden_pixels_take_no_more_than_their_surroundings_have() -> None:
    """A gap to what lies far behind a wall, where the reference sees the wall: it is corrected as the wall is."""
    depth = np.full((64, 96), 3.0, F)
    depth[30:32, 40:42] = 9.0
    view = replace(flat_view(CLIENT, 3.0), depth=depth)
    lack = np.broadcast_to(np.linspace(-0.3, 0.3, 96)[None, :, None], (64, 96, 3))
    reference = Reference(compand(lack, 0.1).astype(F), camera((96, 64), at=(0.3, 0.0, 0.0)))
    out = correct(view, CLIENT, reference)
    assert (out.confidence[30:32, 40:42] == 0).all()
    np.testing.assert_allclose(out.rgb[30:32, 40], (out.rgb[30:32, 39] + out.rgb[30:32, 42]) / 2, atol=0.01)
    assert (np.abs(out.rgb[30:32, 40:42] - 0.5) > 0.02).all()
    half = correct(view, CLIENT, reference, veto=np.full((64, 96), 0.5, F))
    np.testing.assert_allclose(half.rgb[30, 40] - 0.5, (out.rgb[30, 40] - 0.5) / 2, atol=1e-6)
    alone = correct(view, CLIENT, reference, veto=(depth < 9).astype(F))
    np.testing.assert_array_equal(alone.rgb, view.rgb)  # nothing around it has any confidence


def test_holes_beyond_the_reference_are_not_black() -> None:
    """A client that holds nothing but the left half, and a reference that ends within the right one."""
    server = camera((96, 64), turned_rad=-0.4)
    view = flat_view(CLIENT, 3.0)
    alpha, rgb = view.alpha.copy(), view.rgb.copy()
    alpha[:, 48:], rgb[:, 48:] = 0, 0
    view = replace(view, rgb=rgb, alpha=alpha)
    lack = np.zeros((64, 96, 3))
    lack[:, 60:] = 0.6
    reference = Reference(compand(lack, 0.1).astype(F), server)
    out = correct(view, CLIENT, reference)
    np.testing.assert_allclose(out.rgb[:, 80:], 0.6, atol=1e-5)
    assert (out.confidence[:, 48:] == 1).all(), "nor do holes fade at the border"
    wall = correct(replace(view, alpha=np.ones_like(alpha)), CLIENT, reference)
    assert (wall.confidence[:, 80:] == 0).all(), "what is no hole is left alone there"
    behind = camera((96, 64), turned_rad=3.0)
    np.testing.assert_array_equal(correct(view, CLIENT, Reference(reference.coded, behind)).rgb, rgb)


def test_beyond_the_reference_there_is_no_step_from_hole_to_wall() -> None:
    server = camera((96, 64), turned_rad=-0.4)
    alpha = np.linspace(0, 0.6, 64, dtype=F)[:, None].repeat(96, axis=1)
    view = replace(flat_view(CLIENT, 3.0, 0.2), alpha=alpha)
    reference = Reference(compand(np.full((64, 96, 3), 0.5), 0.1).astype(F), server)
    out = correct(view, CLIENT, reference).rgb[:, 90, 0]
    np.testing.assert_allclose(out, 0.2 + 0.5 * np.clip(1 - alpha[:, 90] / 0.3, 0, 1), atol=1e-5)


@pytest.mark.parametrize("knee", [0.05, 0.15])
def test_a_disocclusion_is_nearer_to_the_truth_than_without_a_guess(knee: float) -> None:
    """A near plate before a far wall, both poorly drawn, and a reference from 10 cm beside."""
    size, step = (320, 240), 0.1
    client, server = camera(size), camera((160, 120), at=(step, 0.0, 0.0), fov_rad=1.3)

    def drawn(cam: Camera, at: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        i = cam.intrinsics
        v, u = np.indices((cam.height_px, cam.width_px)) + 0.5
        x, y = (u - i.cx_px) / i.fx_px, (v - i.cy_px) / i.fy_px
        plate = (np.abs(x * 0.8 + at) < 0.2) & (np.abs(y * 0.8) < 0.25)
        depth = np.where(plate, 0.8, 3.0)
        px, py = x * depth + at, y * depth
        shade = np.where(plate, 0.3, 0.6) + 0.05 * np.sin(2 * px + plate) * np.cos(3 * py)
        error = np.where(plate, 0.05, 0.15) + 0.08 * np.sin(1.5 * px + 2 * plate) * np.cos(py)
        return shade, error, depth

    truth, error, depth = drawn(client, 0.0)
    view = RenderedView(
        np.repeat((truth - error)[..., None], 3, axis=2).astype(F), np.ones(truth.shape, F), depth.astype(F), None
    )
    seen = drawn(server, step)[1]
    coded = compand(np.repeat(seen[..., None], 3, axis=2), knee).astype(F)
    out = correct(view, client, Reference(coded, server, knee=knee))
    hidden = (out.confidence == 0) & (depth == 3.0)
    hidden[:, :16] = hidden[:, -16:] = False  # beyond the reference
    assert hidden.mean() > 0.01
    # 4.4 dB; of the cells' means some are of the plate's errors
    assert np.mean((out.rgb[..., 0] - truth)[hidden] ** 2) < 0.4 * np.mean(error[hidden] ** 2)


def test_references_that_make_no_sense_are_refused() -> None:
    with pytest.raises(ValueError, match=r"reference of shape \(36, 48\)"):
        Reference(np.zeros((36, 48), F), SERVER)
    for knee in (0.0, -1.0, float("nan"), 1e9):
        with pytest.raises(ValueError, match="knee = "):
            replace(difference(SERVER), knee=knee)
    with pytest.raises(ValueError, match="client's render from the reference camera"):
        lacking(picture(SERVER), None)
