"""Surfaces of the room: parametric patches with a pattern and a finish."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from cags_common.geometry import F64, Vec3
from cags_encoder.scenes.procedural.textures import Pattern

Shape: TypeAlias = Callable[[F64, F64], F64]
"""Parameters u, v [...] in 0..1 to points [..., 3] in metres; du x dv points outwards."""


@dataclass(frozen=True)
class Finish:
    """How a surface reflects light, and its importance."""

    gloss: float = 0.0  # strength of the mirror image of the light, 0..1
    emission: float = 0.0  # own light instead of the room's, as a factor of its pattern
    detail: float = 1.0  # weight of its errors when splats are distributed
    opacity: float = 0.99


MATT = Finish()


@dataclass(frozen=True)
class Patch:
    """One surface."""

    shape: Shape
    size: tuple[float, float]  # metres along u and v: range of the pattern and unit of detail
    pattern: Pattern
    finish: Finish
    cells: tuple[int, int] = (1, 1)  # least number of splats along u and v, for curved shapes

    def normals(self, u: F64, v: F64) -> F64:
        """Unit outward normals [..., 3]."""
        h = 1e-4
        along_u = self.shape(np.clip(u + h, 0, 1), v) - self.shape(np.clip(u - h, 0, 1), v)
        along_v = self.shape(u, np.clip(v + h, 0, 1)) - self.shape(u, np.clip(v - h, 0, 1))
        normal = np.cross(along_u, along_v)
        units: F64 = normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-15)
        return units


def quad(corner: Vec3, along_u: Vec3, along_v: Vec3, pattern: Pattern, finish: Finish = MATT) -> Patch:
    """A flat rectangle whose outside is the direction of ``along_u x along_v``."""
    o, e, f = (np.asarray(vector, np.float64) for vector in (corner, along_u, along_v))

    def shape(u: F64, v: F64) -> F64:
        points: F64 = o + np.asarray(u)[..., None] * e + np.asarray(v)[..., None] * f
        return points

    return Patch(shape, (float(np.linalg.norm(e)), float(np.linalg.norm(f))), pattern, finish)


def box(low: Vec3, high: Vec3, pattern: Pattern, *, sides: str = "xXyYzZ", finish: Finish = MATT) -> list[Patch]:
    """The faces of an upright box: lower-case letters name the sides at ``low``, capitals those at ``high``."""
    (x0, y0, z0), (x1, y1, z1) = low, high
    dx, dy, dz = x1 - x0, y1 - y0, z1 - z0
    faces: dict[str, tuple[Vec3, Vec3, Vec3]] = {
        "x": ((x0, y0, z0), (0, 0, dz), (0, dy, 0)),
        "X": ((x1, y0, z1), (0, 0, -dz), (0, dy, 0)),
        "y": ((x0, y0, z0), (dx, 0, 0), (0, 0, dz)),
        "Y": ((x0, y1, z1), (dx, 0, 0), (0, 0, -dz)),
        "z": ((x1, y0, z0), (-dx, 0, 0), (0, dy, 0)),
        "Z": ((x0, y0, z1), (dx, 0, 0), (0, dy, 0)),
    }
    return [quad(*faces[side], pattern, finish) for side in sides]


def cushion(centre: Vec3, half: Vec3, pattern: Pattern, power: float = 0.35, finish: Finish = MATT) -> Patch:
    """A superellipsoid: a ball for power 1, nearly a box for small powers."""
    c, h = np.asarray(centre), np.asarray(half)

    def signed(base: F64) -> F64:
        rounded: F64 = np.sign(base) * np.abs(base) ** power
        return rounded

    def shape(u: F64, v: F64) -> F64:
        azimuth, polar = -2 * np.pi * u, np.pi * (v - 0.5)
        ring = signed(np.cos(polar))
        unit = [ring * signed(np.cos(azimuth)), signed(np.sin(polar)), ring * signed(np.sin(azimuth))]
        points: F64 = c + h * np.stack(unit, axis=-1)
        return points

    girth = np.pi * (h[0] + h[2])
    return Patch(shape, (float(girth), float(np.pi * h[1] + 0.5 * (h[0] + h[2]))), pattern, finish, (12, 8))


def ball(centre: Vec3, radius: float, pattern: Pattern, finish: Finish = MATT) -> Patch:
    """A sphere with its poles along y."""
    return cushion(centre, (radius, radius, radius), pattern, 1.0, finish)


def lathe(base: Vec3, profile: list[tuple[float, float]], pattern: Pattern, finish: Finish = MATT) -> Patch:
    """A profile of (radius, height) points, smooth between them, rotated about the vertical axis through ``base``."""
    points = np.asarray(profile, np.float64)
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    b = np.asarray(base)

    def shape(u: F64, v: F64) -> F64:
        azimuth, s = -2 * np.pi * u, v * along[-1]
        radius, height = np.interp(s, along, points[:, 0]), np.interp(s, along, points[:, 1])
        surface: F64 = b + np.stack([radius * np.cos(azimuth), height, radius * np.sin(azimuth)], axis=-1)
        return surface

    girth = 2 * np.pi * float(points[:, 0].mean())
    return Patch(shape, (girth, float(along[-1])), pattern, finish, (12, 2 * len(points)))


def leaf(ends: tuple[Vec3, Vec3], width: float, droop: float, pattern: Pattern, finish: Finish = MATT) -> Patch:
    """A leaf from root to tip, pointed at both ``ends``, bent down by ``droop`` metres and folded at its rib."""
    root, tip = ends
    r, t = np.asarray(root, np.float64), np.asarray(tip, np.float64)
    side = np.cross(t - r, (0.0, 1.0, 0.0))
    side = side / max(float(np.linalg.norm(side)), 1e-9)

    def shape(u: F64, v: F64) -> F64:
        across, half = 2 * v - 1, 0.5 * width * np.sin(np.pi * np.clip(u, 0.03, 0.97)) ** 0.8
        middle = r + np.asarray(u)[..., None] * (t - r) + side * (across * half)[..., None]
        lift = 0.35 * half * np.abs(across) - droop * u * u
        return middle + np.stack([np.zeros_like(lift), lift, np.zeros_like(lift)], axis=-1)

    return Patch(shape, (float(np.linalg.norm(t - r)), width), pattern, finish, (6, 3))
