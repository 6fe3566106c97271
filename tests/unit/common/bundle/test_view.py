"""How the author wants a scene to be opened: read from files and manifests, refused by name, and turned into a view."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cags_common.bundle import Manifest
from cags_common.bundle.first_view import (
    HEIGHT_PX,
    WIDTH_PX,
    first_camera,
    first_pose,
    least_radius,
    thumbnail,
)
from cags_common.bundle.view import AuthorView, read_view
from cags_common.errors import BundleError, ConfigError
from cags_common.geometry import F64, Pose
from cags_common.raster import create
from support.author_views import HOSTILE
from support.capture import three_balls

BOX = ((-1.0, -2.0, -1.0), (1.0, 2.0, 1.0))
OBJECT = Manifest("clip", 30.0, 1, (0,), (9,), 0, BOX, (), ())
WHOLE = AuthorView("A plant", "#1a2b3c", Pose((0.0, 0.0, -3.0), (1.0, 0.0, 0.0, 0.0)), (0.0, 1.0, 0.0), 0.5)

FAULTS = [(name, value) for name, values in HOSTILE.items() for value in values]


def table(view: AuthorView) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(replace(OBJECT, view=view).to_json())["view"]
    return found


def with_view(value: Any) -> bytes:
    return json.dumps({**json.loads(OBJECT.to_json()), "view": value}).encode()


def test_a_manifest_keeps_the_view() -> None:
    manifest = replace(OBJECT, view=WHOLE)
    assert Manifest.from_json(manifest.public_json()) == manifest
    assert b"view" not in OBJECT.to_json()


@pytest.mark.parametrize("name", list(table(WHOLE)))
def test_each_part_may_stand_alone(name: str) -> None:
    part = {name: table(WHOLE)[name]}
    view = Manifest.from_json(with_view(part)).view
    assert view is not None
    assert view.table() == part


@pytest.mark.parametrize(("name", "value"), FAULTS)
def test_hostile_values_are_refused_in_one_line(name: str, value: Any, tmp_path: Path) -> None:
    with pytest.raises(BundleError, match=rf"manifest: view\.{name}") as of_manifest:
        Manifest.from_json(with_view({name: value}))
    file = tmp_path / "view.json"
    file.write_text(json.dumps({name: value}))
    with pytest.raises(ConfigError, match=rf"view = .*view\.json: {name}") as of_file:
        read_view(str(file))
    assert "\n" not in f"{of_manifest.value}{of_file.value}"


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ('{"titel": "x"}', "'titel' is unknown; known: title"),
        ("[]", "must be an object"),
        ("{", "is not JSON .*; give a file as the page"),
    ],
)
def test_a_file_that_is_no_view_is_refused(text: str, told: str, tmp_path: Path) -> None:
    file = tmp_path / "view.json"
    file.write_text(text)
    with pytest.raises(ConfigError, match=told):
        read_view(str(file))
    with pytest.raises(ConfigError, match=r"cannot be read .*; give a file as the page"):
        read_view(str(tmp_path / "none.json"))


def corners(manifest: Manifest, pose: Pose) -> F64:
    """[8, 3] of the bounds, in the camera's frame."""
    box = np.asarray(manifest.bounds)
    world = np.array([[box[i][0], box[j][1], box[k][2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
    return (world - pose.position) @ pose.rotation_matrix


@given(st.tuples(*[st.floats(0.05, 2.0)] * 3), st.floats(0.2, 3.0), st.sampled_from([(0, 1, 0), (0, -1, 0), (0, 0, 1)]))
def test_a_first_view_shows_an_object_whole(half: tuple[float, ...], aspect: float, up: tuple[float, ...]) -> None:
    box = tuple(-h for h in half), half
    manifest = replace(OBJECT, bounds=box, focus_radius=max(half), up=up)  # type: ignore[arg-type]
    tan_x, tan_y = (0.6, 0.6 / aspect) if aspect > 1 else (0.6 * aspect, 0.6)
    x, y, z = corners(manifest, first_pose(manifest, tan_x, tan_y)).T
    assert (z > 0).all()
    assert (np.abs(x) <= tan_x * z * (1 + 1e-6)).all()
    assert (np.abs(y) <= tan_y * z * (1 + 1e-6)).all()


POINTS = [((0.0, 0.0, 0.0), 0.5), ((1.0, -2.0, 3.0), 1e-6), ((1e6, 0.0, 0.0), 1e-3), ((0.0, 0.0, 0.0), 0.0)]


@pytest.mark.parametrize(("at", "radius"), POINTS)
def test_splats_at_one_point_are_seen_by_their_size(at: tuple[float, float, float], radius: float) -> None:
    manifest = replace(OBJECT, bounds=(at, at), focus_centre=at, focus_radius=radius)
    way = np.subtract(at, (pose := first_pose(manifest, 0.5, 0.3)).position)
    distance = np.linalg.norm(way)
    assert np.allclose(way / distance, pose.rotation_matrix[:, 2], atol=1e-6)
    assert distance * math.sin(math.atan(0.3)) > max(radius, least_radius(at))
    assert np.float32(max(at)) + np.float32(distance) > np.float32(max(at)), "renderers can tell the two apart"


@given(st.integers(-9, 9))
def test_a_first_view_scales_with_the_scene(power: int) -> None:
    """In whatever unit, the picture is the same."""
    unit = 10.0**power
    box = tuple(tuple(unit * part for part in corner) for corner in BOX)
    scaled = replace(OBJECT, bounds=box, focus_radius=unit * OBJECT.focus_radius)  # type: ignore[arg-type]
    here, there = first_pose(OBJECT, 0.5, 0.3), first_pose(scaled, 0.5, 0.3)
    assert np.allclose(np.divide(there.position, unit), here.position)
    assert np.allclose(there.rotation, here.rotation)


def test_a_room_is_seen_from_within() -> None:
    room = replace(OBJECT, bounds=((-4.0, -1.0, -4.0), (4.0, 3.0, 4.0)), focus_radius=1.0)
    assert np.abs(first_pose(room, 0.3, 0.2).position).max() < 4.0


def test_the_authors_pose_is_the_first_view() -> None:
    assert first_camera(replace(OBJECT, view=WHOLE), 160, 90).pose == WHOLE.pose
    only_target = AuthorView(target=(5.0, 0.0, 0.0), radius=1.0)
    pose = first_camera(replace(OBJECT, view=only_target), 160, 90).pose
    ahead = pose.rotation_matrix[:, 2]
    way = np.subtract((5.0, 0.0, 0.0), pose.position)
    assert np.allclose(way / np.linalg.norm(way), ahead)
    assert np.linalg.norm(way) > 1.0 / math.sin(math.atan(math.tan(math.pi / 6) * 9 / 16))


def test_a_thumbnail_is_small_and_over_the_authors_background() -> None:
    splats = three_balls(50, 5)
    low, high = (tuple(map(float, corner)) for corner in (splats.means.min(0), splats.means.max(0)))
    manifest = replace(OBJECT, bounds=(low, high), view=AuthorView(background="#c02010"))  # type: ignore[arg-type]
    data = thumbnail(create("auto").load(splats), manifest)
    picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    assert picture.shape == (HEIGHT_PX, WIDTH_PX, 3)
    assert len(data) < 40_000
    assert np.abs(picture[0, 0].astype(int) - (0x10, 0x20, 0xC0)).max() < 8
    assert (picture[..., 2] < 0x80).any(), "and there is something on it"
