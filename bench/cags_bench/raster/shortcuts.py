"""What the shortcuts give up and save: a short walk around the scene's focus, every frame against the exact one."""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Iterator
from typing import Any

import numpy as np

from cags_bench.jsonl import provenance
from cags_common.geometry import Camera, Pose
from cags_common.raster import Exactness, RasterScene, RenderOptions, Shortcuts, create
from cags_common.splats import Splats

STEP_RAD = math.radians(0.2)
"""Between two frames: 12 degrees a second at 60 frames a second."""

Line = dict[str, Any]


def choices(threads: int) -> dict[str, RenderOptions]:
    """What is compared, by name."""

    def kept(degrees: float) -> RenderOptions:
        return RenderOptions(threads=threads, shortcuts=Shortcuts(colour_angle_rad=math.radians(degrees)))

    half = Shortcuts(half_resolution=True)
    return {
        "none": RenderOptions(threads=threads),
        "fast": RenderOptions(threads=threads, exactness=Exactness.FAST),
        "colours kept for 0.5 degrees": kept(0.5),
        "colours kept for 1 degree": kept(1.0),
        "colours kept for 2 degrees": kept(2.0),
        "SH degree 1": RenderOptions(threads=threads, max_sh_degree=1),
        "SH degree 0": RenderOptions(threads=threads, max_sh_degree=0),
        "half resolution": RenderOptions(threads=threads, shortcuts=half),
        "half resolution, fast": RenderOptions(threads=threads, shortcuts=half, exactness=Exactness.FAST),
    }


def walk(camera: Camera, centre: np.ndarray, up: np.ndarray, frames: int) -> list[Camera]:
    """``camera`` and where it goes around ``centre``."""
    arm, axis = np.asarray(camera.pose.position) - centre, up / np.linalg.norm(up)
    cameras = []
    for angle in STEP_RAD * np.arange(frames):
        along = axis * (axis @ arm) * (1 - math.cos(angle))
        x, y, z = centre + arm * math.cos(angle) + np.cross(axis, arm) * math.sin(angle) + along
        target = float(centre[0]), float(centre[1]), float(centre[2])
        ahead = float(axis[0]), float(axis[1]), float(axis[2])
        cameras.append(camera.at(Pose.looking_at((float(x), float(y), float(z)), target, ahead)))
    return cameras


def shortcut_lines(view: Line, splats: Splats, cameras: list[Camera], threads: int) -> Iterator[Line]:
    """One line a choice: median ms of a frame of the walk, ratio to none, and PSNR against the exact level.

    The choices take turns frame by frame, each on a scene of its own: what one keeps must not serve another.
    """
    options = choices(threads)
    scenes = {name: create("cpu").load(splats) for name in options}
    times: dict[str, list[float]] = {name: [] for name in options}
    errors: dict[str, list[float]] = {name: [] for name in options}
    exact = create("cpu").load(splats)
    for camera in cameras:
        right = exact.render(camera, RenderOptions(exactness=Exactness.EXACT, threads=threads)).rgb
        for name, chosen in options.items():
            taken, rgb = _timed(scenes[name], camera, chosen)
            times[name].append(taken)
            errors[name].append(float(np.mean((rgb - right).astype(np.float64) ** 2)))
    whole = statistics.median(times["none"][1:])
    for name in options:
        ms = statistics.median(times[name][1:])  # the first frame fills what is kept
        psnr = -10 * math.log10(max(statistics.fmean(errors[name][1:]), 1e-20))
        figures: Line = {"ms": round(ms, 2), "ratio": round(ms / whole, 3), "psnr_db": round(psnr, 1)}
        yield {"case": "shortcut", **view, "shortcut": name, **figures, **provenance()}


def _timed(scene: RasterScene, camera: Camera, options: RenderOptions) -> tuple[float, np.ndarray]:
    start = time.perf_counter()
    rgb = scene.render(camera, options).rgb
    return (time.perf_counter() - start) * 1e3, rgb
