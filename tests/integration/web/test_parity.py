"""The page and Python draw the same bytes on the same driver: thirty frames, every kind of reference."""

from __future__ import annotations

import base64
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cags_common.correction import Spheres
from cags_common.correction.changed import cell_boxes
from support.web_page import SIZE, WHOLE, Page, drawn_by_python, encoded, page, served
from support.web_page_drawn import camera_of

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1800)]

FRAMES = 30
ROOM = f"procedural:size=800,frames={FRAMES},seed=1,fps=5,degree=1"
STILL = "procedural:size=800,frames=2,seed=1,fps=5,degree=1"
MOVING = f"fourd:splats=700,births=60,frames={FRAMES},fps=5,degree=1,seed=2"
SMALL = ("--reference-width", "64", "--reference-height", "48", "--visible-px", "0")


def whole(viewer: Page, frame: int) -> None:
    viewer.do(f"player.seek({frame}); window.cags.camera.turn(0.05, {0.02 * (frame % 3 - 1)})")
    viewer.until(f"player.shown?.frame === {frame} && {WHOLE}")


@pytest.mark.parametrize("scene", [ROOM, MOVING], ids=["room", "fourd"])
def test_thirty_frames_of_a_live_server(tmp_path: Path, scene: str) -> None:
    bundle = encoded(scene, tmp_path / "clip.cags")
    seen = []
    with served(bundle, tmp_path, *SMALL) as server, page(tmp_path / "profile") as viewer:
        viewer.open(server.url, "paused")
        viewer.until(WHOLE)
        for frame in range(FRAMES):
            whole(viewer, frame)
            seen.append(viewer.shown())
        assert viewer.complaints() == []
    for shown, drawn in zip(seen, drawn_by_python(seen, bundle), strict=True):
        assert shown.values["full"] and shown.pixels[..., :3].any()
        np.testing.assert_array_equal(shown.pixels, drawn, f"frame {shown.frame}")


def text(array: np.ndarray[Any, Any]) -> str:
    return base64.b64encode(np.ascontiguousarray(array).tobytes()).decode()


def wanted(camera: dict[str, Any], *, picture: bool, error: float, changed: int, stale: float) -> dict[str, Any]:
    """A reference for the view of ``camera``, and what changed since it was made."""
    rng = np.random.default_rng(changed)
    view = camera_of(camera)
    spheres = Spheres(
        (view.pose.position + rng.normal(0, 2, (changed, 3))).astype(np.float32),
        rng.uniform(0.01, 0.1, changed).astype(np.float32),
    )
    near, cells = cell_boxes(spheres, view)
    boxes = np.zeros((len(near), 4), np.uint32)
    boxes[:, 0], boxes[:, 1] = cells[:, 0] | cells[:, 1] << 16, cells[:, 2] | cells[:, 3] << 16
    boxes[:, 2] = near.astype(np.float32).view(np.uint32)
    scale = 64 / SIZE[0]
    intrinsics = {name: value * scale for name, value in camera["intrinsics"].items()}
    intrinsics |= {"widthPx": 64, "heightPx": 48}
    coded = rng.random((48, 64, 3), np.float32)
    given = {"coded": text(coded), "camera": {**camera, "intrinsics": intrinsics}, "picture": picture}
    return {
        "reference": {**given, "knee": 0.1, "error": error},
        "boxes": text(boxes),
        "positions": text(spheres.positions),
        "radii": text(spheres.radii),
        "stale": stale,
    }


def test_differences_pictures_what_changed_and_what_is_old(tmp_path: Path) -> None:
    bundle = encoded(STILL, tmp_path / "clip.cags")
    with served(bundle, tmp_path, *SMALL) as server, page(tmp_path / "profile") as viewer:
        viewer.open(server.url, "paused")
        viewer.until(WHOLE)
        camera = viewer.shown().values["camera"]
        cases = [
            wanted(camera, picture=picture, error=error, changed=changed, stale=stale)
            for picture, error, changed, stale in (
                (True, 0.03, 40, 0.35),
                (False, 0.0, 12, 0.0),
                (True, 0.03, 0, 0.0),
                (True, 0.0, 0, 0.0),
                (False, 0.0, 0, 0.6),
            )
        ]
        seen = [viewer.shown(case) for case in cases]
        assert viewer.complaints() == []
    drawn = drawn_by_python(seen, bundle)
    for shown, right in zip(seen, drawn, strict=True):
        np.testing.assert_array_equal(shown.pixels, right)
    assert len({one.tobytes() for one in drawn}) == len(cases), "every case shows something else"
