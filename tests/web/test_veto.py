"""Where the page looks for splats that changed: cells of its picture, as Python's client."""

from __future__ import annotations

import base64
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from cags_common.correction import Spheres
from cags_common.correction.changed import cell_boxes
from cags_common.geometry import Camera, Intrinsics, Pose
from support.node import run_tests


def case(seed: int, width: int, height: int) -> dict[str, Any]:
    rng = np.random.default_rng(seed)
    pose = Pose.looking_at(tuple(rng.normal(0, 2, 3)), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0))
    camera = Camera(Intrinsics(width, height, 0.8 * width, 0.9 * width, width / 2, height / 2), pose, 0.1)
    positions = rng.normal(0, 3, (60, 3)).astype(np.float32)
    radii = rng.uniform(-0.01, 0.5, 60).astype(np.float32)
    near, cells = cell_boxes(Spheres(positions, radii), camera)
    boxes = np.zeros((len(near), 4), np.uint32)
    boxes[:, 0], boxes[:, 1] = cells[:, 0] | cells[:, 1] << 16, cells[:, 2] | cells[:, 3] << 16
    boxes[:, 2] = near.astype(np.float32).view(np.uint32)
    i = asdict(camera.intrinsics)
    named = {"widthPx": "width_px", "heightPx": "height_px", "fxPx": "fx_px", "fyPx": "fy_px"}
    intrinsics = {**{web: i[name] for web, name in named.items()}, "cxPx": i["cx_px"], "cyPx": i["cy_px"]}
    at = {"position": camera.pose.position, "rotation": camera.pose.rotation}
    return {
        "camera": {"intrinsics": intrinsics, "pose": at, "near": camera.near},
        "positions": base64.b64encode(positions.tobytes()).decode(),
        "radii": base64.b64encode(radii.tobytes()).decode(),
        "boxes": boxes.ravel().tolist(),
    }


def test_cells_of_changed_splats(tmp_path: Path) -> None:
    sizes = ((160, 120), (161, 119), (16, 16), (1600, 900))
    run_tests("veto", tmp_path, cases=[case(seed, *sizes[seed % len(sizes)]) for seed in range(12)])
