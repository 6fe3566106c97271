"""Textured shapes that move and bend, as functions of surface coordinates and time, like the content of a 4D model.

Every shape takes surface coordinates ``u, v`` [N] in 0..1 and a time [N] in seconds and gives points [N, 3] in metres,
y up.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from cags_common.geometry import F64
from cags_encoder.scenes.procedural.textures import (
    Noise,
    Pattern,
    bricks,
    fabric,
    mosaic,
    rug,
    stripes,
)

Surface = Callable[[F64, F64, F64], F64]

STEP = 1e-3
"""Step of finite differences, in surface coordinates and in seconds."""


@dataclass(frozen=True)
class Shape:
    """One object of the scene."""

    points: Surface
    pattern: Pattern
    size: tuple[float, float]  # metres along u and v, for the pattern
    area: float  # square metres
    gloss: float
    """Strength of the highlight in the harmonics."""

    def velocities(self, u: F64, v: F64, time_s: F64) -> F64:
        """Velocities [N, 3] in metres per second."""
        ahead: F64 = self.points(u, v, time_s + STEP) - self.points(u, v, time_s - STEP)
        return ahead / (2 * STEP)

    def tangents(self, u: F64, v: F64, time_s: F64) -> tuple[F64, F64]:
        """Directions [N, 3] along u and v, not of unit length."""
        along_u: F64 = self.points(u + STEP, v, time_s) - self.points(u - STEP, v, time_s)
        along_v: F64 = self.points(u, v + STEP, time_s) - self.points(u, v - STEP, time_s)
        return along_u, along_v

    def colours(self, u: F64, v: F64) -> F64:
        """RGB [N, 3] in 0..1."""
        return self.pattern(u * self.size[0], v * self.size[1])


def shapes(noise: Noise) -> list[Shape]:
    """A static rug, a ball and a ring that circle, a column that bends, and a cloth in the wind."""
    gay = ((0.85, 0.2, 0.15), (0.95, 0.8, 0.25), (0.15, 0.45, 0.7), (0.92, 0.9, 0.85))
    return [
        Shape(_floor, rug(noise, 1.5, 1.5), (3.0, 3.0), 9.0, 0.0),
        Shape(_ball, stripes(gay, 0.8), (2.2, 1.1), 1.5, 0.5),
        Shape(_ring, mosaic(noise, 0.16, gay), (3.1, 0.9), 2.9, 0.3),
        Shape(_column, bricks(noise), (1.1, 1.5), 1.7, 0.1),
        Shape(_cloth, fabric((0.3, 0.55, 0.35), noise), (1.2, 0.9), 1.1, 0.0),
    ]


def _stack(x: F64, y: F64, z: F64) -> F64:
    return np.stack(np.broadcast_arrays(x, y, z), axis=-1)


def _floor(u: F64, v: F64, time_s: F64) -> F64:
    return _stack(3.0 * u - 1.5, 0.0 * time_s, 3.0 * v - 1.5)


def _ball(u: F64, v: F64, time_s: F64) -> F64:
    """Radius 0.35 m; rolls around the centre in ten seconds and hops."""
    turn, azimuth = 2 * np.pi * time_s / 10.0, 2 * np.pi * u + time_s
    polar = np.pi * (0.01 + 0.98 * v)
    x, z = 1.1 * np.cos(turn), 1.1 * np.sin(turn)
    y = 0.36 + 0.25 * np.square(np.sin(1.6 * time_s))
    ring = 0.35 * np.sin(polar)
    return _stack(x + ring * np.cos(azimuth), y - 0.35 * np.cos(polar), z + ring * np.sin(azimuth))


def _ring(u: F64, v: F64, time_s: F64) -> F64:
    """A torus of radii 0.5 and 0.15 m that rotates and tilts above the rest."""
    around, tube = 2 * np.pi * u + 0.5 * time_s, 2 * np.pi * v
    reach = 0.5 + 0.15 * np.cos(tube)
    tilt = 0.4 * np.sin(0.9 * time_s)
    x, y, z = reach * np.cos(around), 0.15 * np.sin(tube), reach * np.sin(around)
    return _stack(x, 1.75 + y * np.cos(tilt) - z * np.sin(tilt), z * np.cos(tilt) + y * np.sin(tilt))


def _column(u: F64, v: F64, time_s: F64) -> F64:
    """Radius 0.18 m, height 1.4 m; leans back and forth."""
    lean = 0.45 * np.square(v) * np.sin(1.3 * time_s)
    around = 2 * np.pi * u
    return _stack(0.18 * np.cos(around) + lean, 1.4 * v - 0.4 * np.abs(lean), 0.18 * np.sin(around) + 0.5 * lean)


def _cloth(u: F64, v: F64, time_s: F64) -> F64:
    """1.2 x 0.9 m; hangs by one edge, with waves along it."""
    wave = 0.12 * u * np.sin(7.0 * u - 4.0 * time_s + 2.0 * v)
    return _stack(-1.3 + 0.3 * wave, 0.6 + 0.9 * v, -0.6 + 1.2 * u + 0.0 * v) + _stack(wave, 0.0 * wave, 0.0 * wave)
