"""The moving objects: a ball, a mobile, curtains, a plant, a picture that changes.

An actor's patches are placed at rest and divided into splats with the room's. An :class:`Act` then rewrites the rows of
its splats for any time. It uses only the resting splats, so frames can be generated in any order.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TypeAlias

import numpy as np

from cags_common import so3
from cags_common.geometry import F32, F64, Vec3
from cags_common.splats import SH_C0, SH_REST_OF_DEGREE
from cags_encoder.scenes import rotations
from cags_encoder.scenes.harmonics import lobe
from cags_encoder.scenes.procedural import textures as tex
from cags_encoder.scenes.procedural.light import Lighting, shown
from cags_encoder.scenes.procedural.patches import Finish, Patch, ball, box, leaf, quad
from cags_encoder.scenes.procedural.splatting import SHARPNESS, Surfel
from cags_encoder.scenes.procedural.textures import Noise, Rgb

Columns: TypeAlias = dict[str, F32]
Act: TypeAlias = Callable[[float, Columns], None]
"""Given a time in seconds, rewrites its rows of a frame's columns."""

UNLIT = Finish(gloss=0.5, emission=1.0, detail=2.5)
"""Rigid objects keep their own colour and are lit at their current place."""


@dataclass(frozen=True)
class Actor:
    """Patches at rest, and their motion once they have been divided into ``rows``."""

    patches: list[Patch]
    act: Callable[[Stage], Act]

    def prepared(self, rows: slice, surfels: Surfel, light: Lighting, degree: int) -> Act:
        """The act for the splats at ``rows``."""
        part = Surfel(*(getattr(surfels, name)[rows] for name in Surfel.__dataclass_fields__))
        return self.act(Stage(rows, part, light, degree))


@dataclass(frozen=True)
class Stage:
    """Context of an act: its rows, its splats' surfaces at rest, and the room's light."""

    rows: slice
    surfels: Surfel
    light: Lighting
    degree: int


def cast(noise: Noise, rng: np.random.Generator) -> list[Actor]:
    """All actors; the bubbles of :mod:`.bubbles` come on top."""
    return [_beach_ball(), _ball_shadow(), _mobile(noise), *_curtains(noise), _plant(noise, rng), _screen(noise)]


# ---- rigid objects ----


@dataclass(frozen=True)
class _Rigid:
    """Rotates and moves its rows, and lights them at their current place."""

    stage: Stage
    gloss: float
    pivot: Vec3
    path: Callable[[float], tuple[F64, F64]]  # time, s -> turn (wxyz) and position of the pivot

    def __call__(self, time_s: float, columns: Columns) -> None:
        turn, position = self.path(time_s)
        matrix = so3.matrices(turn)
        surfels, rows = self.stage.surfels, self.stage.rows
        points = (surfels.points - self.pivot) @ matrix.T + position
        normals = surfels.normals @ matrix.T
        columns["means"][rows] = points
        columns["quats"][rows] = rotations.turned(columns["quats"][rows], turn)
        columns["sh0"][rows], columns["sh_rest"][rows] = lit(self.stage, surfels.rgb, points, normals, self.gloss)


def lit(stage: Stage, rgb: F64, points: F64, normals: F64, gloss: float) -> tuple[F64, F64]:
    """Harmonics [M, 3], [M, K, 3] of surfaces of colour ``rgb`` under the room's light at ``points``."""
    light = stage.light.at_moving(points, normals) + stage.light.sunlight(points, normals)
    sh = np.zeros((len(points), 1 + SH_REST_OF_DEGREE[stage.degree], 3))
    sh[:, 0] = (shown(rgb**2.2 * light) - 0.5) / SH_C0
    axes, strength = stage.light.highlight_axes(points, normals)
    sh += (lobe(axes, SHARPNESS, stage.degree) * (gloss * strength)[:, None])[:, :, None]
    return sh[:, 0], sh[:, 1:]


BALL_RADIUS = 0.17
_ORBIT, _ORBIT_S, _HOP_S, _HOP = 0.98, 6.0, 0.75, 0.55


def _ball_place(time_s: float) -> tuple[float, float, float, float]:
    """Angle on the ball's circular path, and position x, y, z of its centre."""
    angle = 2 * np.pi * time_s / _ORBIT_S + 0.6
    hop = (time_s / _HOP_S) % 1.0
    height = BALL_RADIUS + 0.012 + 4 * _HOP * hop * (1 - hop)
    return angle, _ORBIT * np.cos(angle), height, _ORBIT * np.sin(angle)


def _ball_path(time_s: float) -> tuple[F64, F64]:
    angle, x, y, z = _ball_place(time_s)
    rolling = np.array([-np.cos(angle), 0.35, -np.sin(angle)])  # about the line to the table, a little tilted
    roll = rotations.about(rolling / np.linalg.norm(rolling), np.array(_ORBIT / BALL_RADIUS * (angle - 0.6)))
    return roll, np.array([x, y, z])


def _beach_ball() -> Actor:
    girth = np.pi * 2 * BALL_RADIUS
    white: Rgb = (0.95, 0.93, 0.88)
    colours = ((0.92, 0.20, 0.14), white, (0.12, 0.42, 0.75), white, (0.98, 0.76, 0.14), white)
    patch = ball((0.0, 0.0, 0.0), BALL_RADIUS, tex.stripes(colours, girth), UNLIT)
    return Actor([patch], partial(_Rigid, gloss=0.5, pivot=(0.0, 0.0, 0.0), path=_ball_path))


@dataclass(frozen=True)
class _Shadow:
    """Dark, faint splats on the floor below the ball: wider and fainter the higher it is."""

    stage: Stage

    def __call__(self, time_s: float, columns: Columns) -> None:
        _, x, y, z = _ball_place(time_s)
        height = y - BALL_RADIUS
        spread, dark = 1.0 + 1.2 * height, 0.62 / (1.0 + 4.0 * height)
        rows = self.stage.rows
        columns["means"][rows] = self.stage.surfels.points * [spread, 1.0, spread] + [x, 0.0, z]
        columns["log_scales"][rows, :2] += np.float32(np.log(1.9 * spread))
        columns["logit_opacities"][rows] = np.log(dark / (1 - dark))


def _ball_shadow() -> Actor:
    r = 0.6 * BALL_RADIUS
    black = tex.plain((0.03, 0.02, 0.02), Noise(np.random.default_rng(0)), 0.0)
    patch = quad((-r / 2, 0.02, r / 2), (r, 0, 0), (0, 0, -r), black, Finish(emission=1.0, detail=1e-4))
    return Actor([patch], _Shadow)


_HOOK = (0.0, 2.47, 0.0)


def _mobile_path(time_s: float) -> tuple[F64, F64]:
    swing = 0.9 * time_s + 0.5 * np.sin(1.3 * time_s)
    return rotations.about(np.array([0.0, 1.0, 0.0]), np.array(swing)), np.asarray(_HOOK)


def _mobile(noise: Noise) -> Actor:
    """Coloured balls on threads under two crossed bars."""
    wood, thread = tex.wood((0.7, 0.5, 0.3), noise), tex.plain((0.85, 0.85, 0.85), noise)
    colours: tuple[Rgb, ...] = (
        (0.90, 0.22, 0.18),
        (0.98, 0.75, 0.16),
        (0.20, 0.55, 0.36),
        (0.16, 0.38, 0.72),
        (0.72, 0.30, 0.62),
    )
    fine = Finish(emission=1.0, detail=0.5)
    patches = box((-0.42, -0.28, -0.01), (0.42, -0.265, 0.01), wood, finish=fine)
    patches += box((-0.01, -0.26, -0.42), (0.01, -0.245, 0.42), wood, finish=fine)
    patches += box((-0.004, -0.26, -0.004), (0.004, 0.0, 0.004), thread, sides="xXzZ", finish=fine)
    arms = [(-0.4, 0.0, 0.26), (0.4, 0.0, 0.40), (0.0, -0.4, 0.34), (0.0, 0.4, 0.20), (0.0, 0.0, 0.30)]
    for (x, z, drop), rgb in zip(arms, colours, strict=True):
        patches += box(
            (x - 0.003, -0.27 - drop, z - 0.003), (x + 0.003, -0.27, z + 0.003), thread, sides="xXzZ", finish=fine
        )
        patches.append(ball((x, -0.33 - drop, z), 0.075, tex.plain(rgb, noise, 0.1), UNLIT))
    return Actor(patches, partial(_Rigid, gloss=0.45, pivot=(0.0, 0.0, 0.0), path=_mobile_path))


# ---- objects that bend ----


@dataclass(frozen=True)
class _Sway:
    """Leans its rows about a foot, more with height, and flutters the ends."""

    stage: Stage
    foot: Vec3

    def __call__(self, time_s: float, columns: Columns) -> None:
        rows = self.stage.rows
        offsets = self.stage.surfels.points - self.foot
        height = np.maximum(offsets[:, 1], 0.0)
        gust = 0.6 * np.sin(2 * np.pi * time_s / 2.6) + 0.4 * np.sin(2 * np.pi * time_s / 1.1 + 1.0)
        flutter = 0.08 * np.sin(7.0 * time_s + 9.0 * np.hypot(offsets[:, 0], offsets[:, 2]) + 5.0 * offsets[:, 0])
        turns = rotations.about(np.array([0.45, 0.0, 0.893]), 0.13 * gust * height + flutter * height)
        columns["means"][rows] = np.einsum("nij,nj->ni", so3.matrices(turns), offsets) + self.foot
        columns["quats"][rows] = rotations.turned(columns["quats"][rows], turns)


def _plant(noise: Noise, rng: np.random.Generator) -> Actor:
    foot = (-1.85, 0.36, 1.6)
    patches = []
    for k in range(17):
        azimuth, reach, rise = 2.4 * k, rng.uniform(0.22, 0.46), rng.uniform(0.35, 1.05)
        x, z = float(np.cos(azimuth)), float(np.sin(azimuth))
        root = (foot[0] + 0.03 * x, foot[1] + 0.25 * rise, foot[2] + 0.03 * z)
        tip = (foot[0] + reach * x, foot[1] + rise, foot[2] + reach * z)
        green: Rgb = (0.16 + 0.14 * rng.uniform(), 0.40 + 0.16 * rng.uniform(), 0.16)
        patches.append(leaf((root, tip), 0.17, 0.12, _veins(green, noise), Finish(gloss=0.12, detail=1.6)))
        stalk = tex.plain((0.30, 0.42, 0.18), noise)
        patches.append(leaf((foot, root), 0.02, 0.0, stalk, Finish(detail=0.5)))
    return Actor(patches, partial(_Sway, foot=foot))


def _veins(rgb: Rgb, noise: Noise) -> tex.Pattern:
    def pattern(x: F64, y: F64) -> F64:
        from_rib = np.abs(y - 0.085)
        vein = np.cos(2 * np.pi * (x - 0.9 * from_rib) / 0.045)
        colour = tex.mix(rgb, (0.55, 0.68, 0.36), 0.5 * tex.step(0.9, vein, 0.2))
        colour = tex.mix(colour, (0.62, 0.72, 0.42), tex.step(0.0, 0.005 - from_rib, 0.004))
        return colour * (0.85 + 0.3 * noise.fractal(x, y, 0.08))[..., None]

    return pattern


@dataclass(frozen=True)
class _Wave:
    """A hanging cloth whose folds travel, more towards its free lower end."""

    stage: Stage
    rail: float  # height of the fixed upper edge, metres

    def __call__(self, time_s: float, columns: Columns) -> None:
        rows, points = self.stage.rows, self.stage.surfels.points
        free = np.clip((self.rail - points[:, 1]) / 2.0, 0.0, 1.0) ** 1.5
        phase = 9.0 * points[:, 2] + 2.2 * points[:, 1]
        billow = 0.5 + 0.5 * np.sin(2 * np.pi * time_s / 3.1 + 0.8 * points[:, 2])
        columns["means"][rows, 0] = points[:, 0] + free * (0.05 * np.sin(phase - 3.2 * time_s) + 0.10 * billow)
        slope = free * 0.05 * 9.0 * np.cos(phase - 3.2 * time_s)
        turns = rotations.about(np.array([0.0, 1.0, 0.0]), np.arctan(slope))
        columns["quats"][rows] = rotations.turned(columns["quats"][rows], turns)


def _curtains(noise: Noise) -> list[Actor]:
    rail = 2.34
    actors = []
    for z in (1.42, -1.08):

        def shape(u: F64, v: F64, z: float = z) -> F64:
            fold = 0.035 * np.sin(2 * np.pi * 5 * u)
            return np.stack([-2.27 + fold, 0.14 + (rail - 0.14) * v, z - 0.56 * u + 0.0 * v], axis=-1)

        cloth = _border(tex.fabric((0.80, 0.78, 0.70), noise), noise)
        patch = Patch(shape, (0.75, rail - 0.14), cloth, Finish(detail=0.8), (20, 8))
        actors.append(Actor([patch], partial(_Wave, rail=rail)))
    return actors


def _border(cloth: tex.Pattern, noise: Noise) -> tex.Pattern:
    def pattern(x: F64, y: F64) -> F64:
        motif = np.cos(2 * np.pi * x / 0.15) * np.cos(2 * np.pi * y / 0.2)
        rgb = tex.mix(cloth(x, y), (0.62, 0.30, 0.24), 0.75 * tex.step(0.55, motif, 0.15))
        return tex.mix(rgb, (0.45, 0.18, 0.16), tex.step(0.0, 0.02 - np.abs(y - 0.1), 0.01))

    return pattern


# ---- objects that change colour ----

_TILES = (8, 4)
_HOLD_S = 0.4


@dataclass(frozen=True)
class _Slides:
    """A panel of coloured tiles. Tiles keep their colour for a while, so that only some change in a frame."""

    stage: Stage

    def __call__(self, time_s: float, columns: Columns) -> None:
        uv = self.stage.surfels.uv
        column, row = np.floor(uv[:, 0] * _TILES[0]), np.floor(uv[:, 1] * _TILES[1])
        beat = np.floor(time_s / _HOLD_S + (0.37 * column + 0.61 * row) % 1.0)  # tiles do not all change at once
        hue = 0.31 * column + 0.17 * row + 0.23 * beat
        rgb = 0.55 + 0.42 * np.cos(2 * np.pi * (hue[:, None] + np.array([0.0, 0.33, 0.67])))
        edge = np.minimum(_from_edge(uv[:, 0] * _TILES[0]), _from_edge(uv[:, 1] * _TILES[1]))
        shape = _from_edge(uv[:, 0] * _TILES[0]) + _from_edge(uv[:, 1] * _TILES[1])
        rgb = np.where((shape > 0.6)[:, None] & (beat % 2 > 0)[:, None], 1.0 - 0.6 * rgb, rgb)
        rgb = np.where((edge < 0.06)[:, None], 0.05, rgb)
        columns["sh0"][self.stage.rows] = (rgb - 0.5) / SH_C0


def _from_edge(t: F64) -> F64:
    """Distance from the nearest integer."""
    return np.abs(t - np.round(t))


def _screen(noise: Noise) -> Actor:
    corner, width, height = (2.365, 1.30, -0.75), 1.5, 0.75

    def tiles(x: F64, y: F64) -> F64:  # only for dividing splats: edges as those of the tiles
        edge = np.minimum(_from_edge(x / width * _TILES[0]), _from_edge(y / height * _TILES[1]))
        checker = (np.floor(x / width * _TILES[0]) + np.floor(y / height * _TILES[1])) % 2
        return tex.mix((0.0, 0.0, 0.0), tex.mix((0.9, 0.5, 0.2), (0.2, 0.5, 0.9), checker), tex.step(0.05, edge))

    panel = quad(corner, (0, 0, width), (0, height, 0), tiles, Finish(emission=1.0, detail=1.2))
    return Actor([panel], _Slides)
