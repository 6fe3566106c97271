"""The readable definition of the correction: its parts by themselves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cags_common.correction import CorrectSettings, Placement, Reference, compand
from cags_common.correction.base import FAR
from cags_common.correction.oracle import correct, filled, lacking
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
    assert (out.rgb[out.confidence == 0] == 0.5).all()


def test_references_that_make_no_sense_are_refused() -> None:
    with pytest.raises(ValueError, match=r"reference of shape \(36, 48\)"):
        Reference(np.zeros((36, 48), F), SERVER)
    for knee in (0.0, -1.0, float("nan"), 1e9):
        with pytest.raises(ValueError, match="knee = "):
            replace(difference(SERVER), knee=knee)
    with pytest.raises(ValueError, match="client's own view"):
        lacking(picture(SERVER), None)
