"""A small scene with occlusion and holes, a client and a server that look at it, and what the definition shows."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from cags_common.correction import Corrected, Correction, Reference, compand
from cags_common.correction.oracle import correct
from cags_common.geometry import Camera, Intrinsics, Pose
from cags_common.raster import DepthKind, Exactness, RenderOptions
from cags_common.raster.base import RasterScene
from cags_common.splats import Splats
from support.raster_scenes import F, camera, random_splats

EXACT = RenderOptions(exactness=Exactness.EXACT)
CLIENT = camera(96, 64)
SERVER = Camera(
    Intrinsics.of_fov(48, 36, 1.1, 2 * math.atan(math.tan(0.55) * 36 / 48)),
    Pose.looking_at((0.9, 0.3, -4.7), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0)),
)


def plates() -> Splats:
    """A wall, and discs before it: occlusion, silhouettes, and holes around them."""
    rng = np.random.default_rng(0)
    wall = random_splats(400, seed=1, log_scale=-1.6)
    wall.means[:] = np.stack([*rng.uniform(-2, 2, (2, 400)), rng.uniform(1.4, 1.6, 400)], axis=1)
    near = random_splats(60, seed=2, log_scale=-1.5)
    near.means[:, 2] = rng.uniform(-2.1, -1.9, 60)  # not one depth: the order of ties hangs on the colours
    for part in (wall, near):
        part.logit_opacities[:] = 3.0
    both = zip(wall.arrays(), near.arrays(), strict=True)
    return Splats(*(np.concatenate([far, close]) for (_, far), (_, close) in both))


def lack(seed: int = 3) -> np.ndarray:
    """What a client may lack [36, 48, 3]."""
    return np.random.default_rng(seed).normal(size=(36, 48, 3)).astype(F) * F(0.2)


def reference(**changed: object) -> Reference:
    """A difference seen by the server, or with ``changed`` fields."""
    return replace(Reference(compand(lack(), 0.1).astype(F), SERVER), **changed)


def by_definition(scene: RasterScene, seen_by: Camera, options: RenderOptions, given: Correction) -> Corrected:
    """Corrected from the scene's own view: a z-test may hang on the last bit of a depth."""
    drawing = replace(options, depth=DepthKind.EXPECTED)
    view = scene.render(seen_by, drawing)
    own = scene.render(given.reference.camera, given.own_drawing(options)).rgb if given.reference.picture else None
    return correct(view, seen_by, given.reference, own, given.settings, veto=given.veto(view, seen_by))


def share_within(a: np.ndarray, b: np.ndarray) -> float:
    """Share of the pixels whose channels all differ by no more than one level of 255."""
    return float((np.abs(a.astype(np.float64) - b) <= 1 / 255).all(axis=2).mean())
