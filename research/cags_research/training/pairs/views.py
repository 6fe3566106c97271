"""Where clients look, and where the server thought that they would."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from cags_common.bundle import Manifest
from cags_common.geometry import (
    Camera,
    Intrinsics,
    Pose,
    Vec3,
    multiply_quaternions,
    quaternion_of_rotation_vector,
)
from cags_common.poses import Focus, PoseTrace, open_poses
from cags_protocol.wire.messages import PoseSample
from cags_research.training.pairs.settings import PairSettings
from cags_server.fov import widened
from cags_server.predict import PoseHistory, create_predictor

CLIENT_SIZES = ((640, 480), (800, 600), (1200, 900), (1600, 1200))
"""Client pictures; a reference pixel is 1.5 to 5 of their pixels wide."""

SYNTHETIC_KINDS = ("walking", "looking", "turning")
HISTORY_US = 1_500_000
POSE_PERIOD_US = 1_000_000 // 60


@dataclass(frozen=True, slots=True)
class View:
    """A client's camera and the camera that its reference was rendered from."""

    client: Camera
    reference: Camera


def focus_of_manifest(manifest: Manifest) -> Focus:
    """What walks are placed around."""
    return Focus(manifest.focus_centre, manifest.focus_radius, manifest.up)


def open_walks(specs: tuple[str, ...], focus: Focus, seed: int) -> list[PoseTrace]:
    """The walks of ``specs`` and three synthetic ones, placed in the scene. Raises :class:`TraceError`."""
    synthetic = [open_poses(f"synthetic:{kind}:seed={seed}", focus) for kind in SYNTHETIC_KINDS]
    return synthetic + [open_poses(spec, focus) for spec in specs]


def draw_view(rng: np.random.Generator, manifest: Manifest, walks: list[PoseTrace], settings: PairSettings) -> View:
    """A moment of a walk: half of the references are at the pose that the server's predictor would have guessed, the
    others at one that is off by a drawn turn (about 4 degrees) and step (up to a tenth of the scene's radius).
    """
    walk = walks[rng.integers(len(walks))]
    t_us = int(rng.integers(HISTORY_US, max(walk.duration_us, HISTORY_US + 1)))
    pose = walk.pose_at(t_us)
    if rng.random() < 0.5:
        predicted = _predicted(walk, t_us, int(rng.integers(0, settings.horizon_ms_high * 1000 + 1)))
    else:
        predicted = _off(rng, pose, math.radians(rng.rayleigh(3.0)), rng.uniform(0, 0.1) * manifest.focus_radius)
    width, height = CLIENT_SIZES[rng.integers(len(CLIENT_SIZES))]
    fov_x = math.radians(rng.uniform(50, 85))
    fov_y = 2 * math.atan(math.tan(fov_x / 2) * height / width)
    client = Intrinsics.of_fov(width, height, fov_x, fov_y)
    margins = (rng.uniform(0, settings.margin_high), rng.uniform(0, settings.margin_high))
    reference = widened(client, margins, settings.reference_width, settings.reference_height)
    return View(Camera(client, pose, manifest.near), Camera(reference, predicted, manifest.near))


def nudged(rng: np.random.Generator, camera: Camera, manifest: Manifest) -> Camera:
    """``camera`` as it was some frames ago: turned by about a degree and a fiftieth of the scene's radius away."""
    pose = _off(rng, camera.pose, math.radians(rng.rayleigh(1.0)), rng.uniform(0, 0.02) * manifest.focus_radius)
    return Camera(camera.intrinsics, pose, camera.near)


def _predicted(walk: PoseTrace, t_us: int, horizon_us: int) -> Pose:
    seen = t_us - horizon_us
    times = [t for t in range(seen - HISTORY_US, seen + 1, POSE_PERIOD_US) if t >= 0] or [max(seen, 0)]
    samples = [PoseSample(t, pose) for t, pose in zip(times, walk.poses_at(times), strict=True)]
    return create_predictor("linear").predict(PoseHistory(samples), t_us - times[-1]).pose


def _off(rng: np.random.Generator, pose: Pose, angle_rad: float, distance: float) -> Pose:
    axis, step = _direction(rng), _direction(rng)
    turn = quaternion_of_rotation_vector((axis[0] * angle_rad, axis[1] * angle_rad, axis[2] * angle_rad))
    x, y, z = (p + distance * s for p, s in zip(pose.position, step, strict=True))
    return Pose((x, y, z), multiply_quaternions(pose.rotation, turn))


def _direction(rng: np.random.Generator) -> Vec3:
    v = rng.normal(size=3)
    x, y, z = (float(c) for c in v / max(float(np.linalg.norm(v)), 1e-9))
    return (x, y, z)
