"""The embedded scene: a lit, textured room with a glossy moving ball."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cags_common.geometry import F64, Vec3
from cags_common.settings import check_settings, setting
from cags_common.splats import SH_C0, Ids, Splats
from cags_encoder.scenes.source import DEFAULT_FPS, MAX_FRAMES, Focus


@dataclass(frozen=True)
class ProceduralSettings:
    """Size and length of the procedural room."""

    size: int = setting(60_000, "number of splats", low=500, high=4_000_000)
    frames: int = setting(60, "number of frames", low=1, high=MAX_FRAMES)
    seed: int = setting(1, "seed of everything random", low=0, high=2**31 - 1)
    fps: float = setting(DEFAULT_FPS, "frames a second", low=1.0, high=240.0)

    def __post_init__(self) -> None:
        check_settings(self)


class ProceduralScene:
    """A room of 4 x 2.6 x 4 m, y up, with a ball that moves about."""

    def __init__(self, settings: ProceduralSettings) -> None:
        self._settings = settings
        rng = np.random.default_rng(settings.seed)
        self._ball_count = settings.size // 10
        self._static = _room(rng, settings.size - self._ball_count)
        self._ball = _ball(self._ball_count)

    @property
    def name(self) -> str:
        """Always ``procedural``."""
        return "procedural"

    @property
    def fps(self) -> float:
        """Frames a second."""
        return self._settings.fps

    @property
    def up(self) -> Vec3:
        """+Y."""
        return (0.0, 1.0, 0.0)

    @property
    def focus(self) -> Focus:
        """The middle of the room."""
        return Focus((0.0, 1.0, 0.0), 0.7)

    def __len__(self) -> int:
        return self._settings.frames

    def frame(self, index: int) -> Splats:
        """The room with the ball at its place of frame ``index``."""
        if not 0 <= index < len(self):
            raise IndexError(index)
        turn = 2 * np.pi * index / 60
        centre = np.array([0.8 * np.cos(turn), 0.35 + 0.5 * abs(np.sin(2 * turn)), 0.8 * np.sin(turn)], np.float32)
        ball = Splats(**{**dict(self._ball.arrays()), "means": self._ball.means + centre})
        return Splats.concatenate([self._static, ball]).checked("procedural")

    def ids(self, index: int) -> Ids | None:
        """Rows are identities."""
        if not 0 <= index < len(self):
            raise IndexError(index)
        return np.arange(self._settings.size, dtype=np.int32)


def _room(rng: np.random.Generator, count: int) -> Splats:
    half = np.array([2.0, 1.3, 2.0])
    areas = np.repeat([half[1] * half[2], half[0] * half[2], half[0] * half[1]], 2)
    faces = rng.choice(6, size=count, p=areas / areas.sum())
    axis = faces // 2
    points = rng.uniform(-1, 1, (count, 3))
    points[np.arange(count), axis] = np.where(faces % 2, 1.0, -1.0)
    means = points * half + [0, 1.3, 0]
    checker = np.floor(means * 2.5 + 1e-3).astype(int).sum(axis=1) % 2
    base = np.array(
        [[0.8, 0.5, 0.4], [0.5, 0.7, 0.5], [0.6, 0.5, 0.3], [0.9, 0.9, 0.9], [0.5, 0.5, 0.8], [0.8, 0.8, 0.5]]
    )
    light = 0.55 + 0.45 * np.exp(-0.3 * np.sum((means - [0.0, 2.4, 0.0]) ** 2, axis=1))
    rgb = base[faces] * (0.8 + 0.2 * checker[:, None]) * light[:, None]
    spacing = np.sqrt(4 * areas.sum() / count)
    scales = np.full((count, 3), spacing * 0.7)
    scales[np.arange(count), axis] = spacing * 0.1
    return _splats(means, scales, rgb, np.zeros((count, 8, 3)))


def _ball(count: int) -> Splats:
    k = np.arange(count) + 0.5
    z, azimuth = 1 - 2 * k / count, np.pi * (1 + 5**0.5) * k
    ring = np.sqrt(1 - z * z)
    normal = np.stack([ring * np.cos(azimuth), z, ring * np.sin(azimuth)], axis=1)
    rgb = np.where((np.floor(azimuth * 4 / np.pi).astype(int) % 2)[:, None] == 0, [0.85, 0.15, 0.1], [0.95, 0.9, 0.8])
    rgb = rgb * (0.55 + 0.45 * np.maximum(normal[:, 1:2], 0))
    rest = np.zeros((count, 8, 3))
    rest[:, :3] = 0.15 * np.stack([normal[:, 1], -normal[:, 2], normal[:, 0]], axis=1)[:, :, None]
    return _splats(normal * 0.3, np.full((count, 3), 0.3 * np.sqrt(4 * np.pi / count) * 0.6), rgb, rest)


def _splats(means: F64, scales: F64, rgb: F64, rest: F64) -> Splats:
    count = len(means)
    quats = np.tile([1.0, 0, 0, 0], (count, 1))
    arrays = (means, quats, np.log(scales), np.full(count, 4.0), (rgb - 0.5) / SH_C0, rest)
    return Splats(*(np.asarray(array, np.float32) for array in arrays))
