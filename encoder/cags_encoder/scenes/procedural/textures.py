"""Surface patterns as functions of surface coordinates in metres: any resolution, no files.

Every pattern takes coordinates ``x, y`` [...] in metres and returns display-referred RGB [..., 3] in 0..1.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from cags_common.geometry import F64

Pattern: TypeAlias = Callable[[F64, F64], F64]
Rgb: TypeAlias = tuple[float, float, float]
Ints: TypeAlias = NDArray[np.int64]

_TABLE = 256


class Noise:
    """Smooth random functions of the plane from one seeded table, repeating every 256 cells."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._table: F64 = rng.uniform(0.0, 1.0, (_TABLE, _TABLE))

    def cell(self, i: F64, j: F64) -> F64:
        """A value in 0..1 for each pair of integers."""
        return self._at(np.asarray(i).astype(np.int64), np.asarray(j).astype(np.int64))

    def value(self, x: F64, y: F64, size: float) -> F64:
        """Smooth noise in 0..1 with features of about ``size`` metres."""
        x, y = x / size, y / size
        i, j = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
        u, v = _smooth(x - i), _smooth(y - j)
        low = self._at(i, j) * (1 - u) + self._at(i + 1, j) * u
        return low * (1 - v) + (self._at(i, j + 1) * (1 - u) + self._at(i + 1, j + 1) * u) * v

    def fractal(self, x: F64, y: F64, size: float, octaves: int = 4) -> F64:
        """Noise in 0..1 at ``size`` and, with decreasing strength, at repeated halves of it."""
        total, weight = np.zeros(np.broadcast(x, y).shape), 0.0
        for octave in range(octaves):
            total = total + 0.5**octave * self.value(x + 17.3 * octave, y - 9.1 * octave, size / 2**octave)
            weight += 0.5**octave
        mean: F64 = total / weight
        return mean

    def _at(self, i: Ints, j: Ints) -> F64:
        values: F64 = self._table[(i + 37 * (j >> 8)) % _TABLE, (j + 91 * (i >> 8)) % _TABLE]
        return values


def _smooth(t: F64) -> F64:
    smooth: F64 = t * t * (3.0 - 2.0 * t)
    return smooth


def step(edge: float, x: F64, width: float = 0.02) -> F64:
    """0 below ``edge``, 1 above, smooth over ``width``."""
    return _smooth(np.clip((x - edge) / width + 0.5, 0.0, 1.0))


def mix(a: F64 | Rgb, b: F64 | Rgb, t: F64) -> F64:
    """``a`` for ``t`` = 0, ``b`` for 1."""
    mixed: F64 = np.asarray(a) + (np.asarray(b) - np.asarray(a)) * np.asarray(t)[..., None]
    return mixed


def plain(rgb: Rgb, noise: Noise, grain: float = 0.04) -> Pattern:
    """One colour with faint irregularities, like plaster or painted wood."""
    return lambda x, y: np.asarray(rgb) * (1.0 + grain * (2.0 * noise.fractal(x, y, 0.35, 5) - 1.0))[..., None]


def wood(rgb: Rgb, noise: Noise) -> Pattern:
    """Wood with its grain along x."""

    def pattern(x: F64, y: F64) -> F64:
        rings = noise.fractal(x * 0.6, y * 9.0, 0.25, 5)
        fine = noise.value(x * 3.0, y * 60.0, 0.1)
        return np.asarray(rgb) * (0.62 + 0.55 * rings + 0.14 * fine)[..., None]

    return pattern


def planks(noise: Noise, length: float = 1.15, width: float = 0.15) -> Pattern:
    """A floor of staggered boards along x."""
    board = wood((0.72, 0.50, 0.32), noise)

    def pattern(x: F64, y: F64) -> F64:
        row = np.floor(y / width)
        shifted = x + length * noise.cell(row, np.full_like(row, 7.0))
        column = np.floor(shifted / length)
        tone = 0.72 + 0.5 * noise.cell(column, row)
        rgb = board(x + 3.0 * column, y + 0.37 * row) * tone[..., None]
        gap = np.minimum(_edge(y / width) * width, _edge(shifted / length) * length)
        return rgb * (0.35 + 0.65 * step(0.004, gap, 0.006))[..., None]

    return pattern


def _edge(t: F64) -> F64:
    """Distance from the nearest integer."""
    return np.abs(t - np.round(t))


def bricks(noise: Noise, width: float = 0.23, height: float = 0.08) -> Pattern:
    """Red bricks in stretcher bond with pale mortar."""

    def pattern(x: F64, y: F64) -> F64:
        row = np.floor(y / height)
        shifted = x + 0.5 * width * (row % 2)
        tone = noise.cell(np.floor(shifted / width), row)
        rgb = mix((0.52, 0.24, 0.18), (0.72, 0.42, 0.30), tone) * (0.75 + 0.5 * noise.fractal(x, y, 0.06, 3))[..., None]
        gap = np.minimum(_edge(y / height) * height, _edge(shifted / width) * width)
        return mix((0.70, 0.66, 0.60), rgb, step(0.006, gap, 0.005))

    return pattern


def wallpaper(noise: Noise) -> Pattern:
    """Ornaments in two tones of blue-green above a panelled wainscot."""

    def pattern(x: F64, y: F64) -> F64:
        u, v = 2 * np.pi * x / 0.34, 2 * np.pi * y / 0.34
        ornament = (
            np.cos(u) * np.cos(v) + 0.55 * np.cos(2 * u + np.sin(v)) * np.cos(2 * v) + 0.3 * np.cos(3 * u) * np.cos(v)
        )
        paper = mix((0.13, 0.29, 0.31), (0.30, 0.50, 0.48), step(0.25, ornament, 0.35))
        paper = mix(paper, (0.80, 0.70, 0.45), step(1.0, ornament, 0.2))
        panel = np.minimum(_edge(x / 0.55) * 0.55, np.minimum(np.abs(y - 0.12), np.abs(y - 0.78)))
        cream = np.array([0.86, 0.83, 0.76]) * (0.72 + 0.28 * step(0.03, np.abs(panel - 0.05), 0.03))[..., None]
        cream = cream * (0.97 + 0.06 * noise.fractal(x, y, 0.2))[..., None]
        return mix(cream, paper, step(0.92, y, 0.01))

    return pattern


def rug(noise: Noise, half_x: float, half_y: float) -> Pattern:
    """A knotted rug with a medallion and a patterned border."""

    def pattern(x: F64, y: F64) -> F64:
        x, y = x - half_x, y - half_y
        margin = np.minimum(half_x - np.abs(x), half_y - np.abs(y))
        ring = np.hypot(x / half_x, y / half_y)
        petals = 0.08 * np.cos(12 * np.arctan2(y / half_y, x / half_x))
        small = np.cos(2 * np.pi * x / 0.16) * np.cos(2 * np.pi * y / 0.16)
        field = mix((0.55, 0.10, 0.10), (0.78, 0.62, 0.36), step(0.72, small, 0.2))
        field = mix(field, (0.12, 0.16, 0.34), step(0.0, 0.55 + petals - ring, 0.03))
        field = mix(field, (0.86, 0.76, 0.54), step(0.0, 0.05 - np.abs(ring - 0.55 - petals), 0.03))
        field = mix(field, (0.80, 0.30, 0.18), step(0.0, 0.26 - 2 * petals - ring, 0.03))
        border = mix(
            (0.14, 0.17, 0.36), (0.85, 0.72, 0.45), step(0.3, np.cos(2 * np.pi * x / 0.1) * np.cos(2 * np.pi * y / 0.1))
        )
        rgb = mix(border, field, step(0.18, margin, 0.008))
        rgb = mix(rgb, (0.88, 0.80, 0.62), step(0.0, 0.012 - np.abs(margin - 0.18), 0.008))
        knots = 0.86 + 0.2 * noise.value(x, y, 0.012) + 0.1 * (noise.value(x, y, 0.1) - 0.5)
        return rgb * knots[..., None]

    return pattern


def fabric(rgb: Rgb, noise: Noise) -> Pattern:
    """Woven cloth."""

    def pattern(x: F64, y: F64) -> F64:
        weave = 0.03 * np.sin(2 * np.pi * x / 0.02) * np.sin(2 * np.pi * y / 0.02)
        return np.asarray(rgb) * (0.94 + weave + 0.12 * noise.fractal(x, y, 0.3, 3))[..., None]

    return pattern


def stripes(colours: tuple[Rgb, ...], period: float) -> Pattern:
    """Bands across x."""
    table = np.asarray(colours)

    def pattern(x: F64, y: F64) -> F64:
        rgb: F64 = table[np.floor(x / period * len(table)).astype(np.int64) % len(table)] + 0.0 * y[..., None]
        return rgb

    return pattern


def landscape(noise: Noise, width: float, height: float, sky: tuple[Rgb, Rgb], land: Rgb) -> Pattern:
    """Hills under a sky: a painting, or the view from a window."""

    def pattern(x: F64, y: F64) -> F64:
        u, v = x / width, y / height
        rgb = mix(sky[1], sky[0], np.clip(v * 1.2 - 0.2, 0, 1))
        rgb = mix(rgb, (1.0, 0.95, 0.8), step(0.0, 0.09 - np.hypot((u - 0.68) * width / height, v - 0.74), 0.03))
        clouds = noise.fractal(u * 2.0, v * 5.0, 0.6, 5)
        rgb = mix(rgb, (1.0, 0.97, 0.95), 0.7 * step(0.58, clouds, 0.25) * step(0.45, v, 0.3))
        for layer in range(3):
            ridge = 0.48 - 0.14 * layer + 0.22 * (noise.fractal(u + 5.0 * layer, np.full_like(u, layer), 0.35, 5) - 0.5)
            shade = (0.55 + 0.3 * (2 - layer) / 2) * (0.8 + 0.4 * noise.fractal(u, v, 0.05, 3))
            rgb = mix(rgb, np.asarray(land) * shade[..., None], step(0.0, ridge - v, 0.01))
        return rgb

    return pattern


def mosaic(noise: Noise, size: float, palette: tuple[Rgb, ...]) -> Pattern:
    """An abstract painting of rectangles split by dark lines."""
    table = np.asarray(palette)

    def pattern(x: F64, y: F64) -> F64:
        column = np.floor(x / size + 0.4 * np.sin(3.0 * np.floor(y / size)))
        row = np.floor(y / size)
        pick = (noise.cell(column + 11, row + 5) * len(table)).astype(np.int64)
        gap = np.minimum(_edge(x / size + 0.4 * np.sin(3.0 * row)), _edge(y / size)) * size
        return (
            mix((0.06, 0.06, 0.07), table[pick], step(0.006, gap, 0.004))
            * (0.9 + 0.2 * noise.fractal(x, y, 0.03))[..., None]
        )

    return pattern
