"""The generated 4D clip as a sequence of frames."""

from __future__ import annotations

import math
from collections import OrderedDict
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cags_common.errors import ConfigError
from cags_common.geometry import F64, Vec3
from cags_common.settings import check_settings, setting
from cags_common.splats import SH_C0, SH_REST_OF_DEGREE, Ids, Splats
from cags_encoder.formats.timed import FAINTEST, TimedSplats
from cags_encoder.scenes import rotations
from cags_encoder.scenes.fourd.shapes import Shape, shapes
from cags_encoder.scenes.harmonics import lobe
from cags_encoder.scenes.procedural.textures import Noise
from cags_encoder.scenes.source import DEFAULT_FPS, MAX_FRAMES, Focus

SPREAD = 0.9
"""Standard deviation of the logarithm of lifetimes, before the longest are cut off."""

LONGEST = 4.0
"""Longest lifetime, in mean lifetimes."""

FACES = 0.9
"""Standard deviation of a splat along the surface, in distances to its neighbours."""

SHARPNESS = 8.0
LIGHT = (0.36, 0.8, 0.48)


@dataclass(frozen=True)
class FourdOptions:
    """Size and length of the generated 4D clip."""

    splats: int = setting(60_000, "mean number of splats in a frame", low=100, high=4_000_000)
    births: int = setting(7_500, "new splats per frame; the mean lifetime is splats / births frames", low=1)
    degree: int = setting(3, "spherical-harmonics degree", low=0, high=3)
    frames: int = setting(60, "number of frames", low=1, high=MAX_FRAMES)
    fps: float = setting(DEFAULT_FPS, "frames per second", low=1.0, high=240.0)
    seed: int = setting(1, "seed of everything random", low=0, high=2**31 - 1)

    def __post_init__(self) -> None:
        check_settings(self)
        if self.births > self.splats:
            raise ConfigError(
                f"births = {self.births} exceeds splats = {self.splats}; lifetimes must be at least one frame"
            )
        if (self.frames + self.window) * self.births >= 2**31:
            raise ConfigError(f"births = {self.births} in {self.frames} frames are too many to number; give fewer")

    @property
    def life(self) -> float:
        """Mean lifetime in frames."""
        return self.splats / self.births

    @property
    def window(self) -> int:
        """Number of frames in which the live splats of a frame can have been born."""
        return math.ceil(LONGEST * self.life) + 1


class FourdScene:
    """Moving, textured shapes covered by splats that appear, drift along a straight line and disappear.

    The same options give bit-identical frames. One batch of splats is born per frame; it depends on the seed alone.
    """

    def __init__(self, options: FourdOptions) -> None:
        self._options = options
        self._shapes = shapes(Noise(np.random.default_rng(options.seed)))
        self._lives = _lives(options.births, options.life)
        self._batches: OrderedDict[int, TimedSplats] = OrderedDict()

    @property
    def name(self) -> str:
        """Always ``fourd``."""
        return "fourd"

    @property
    def fps(self) -> float:
        """Frames per second."""
        return self._options.fps

    @property
    def up(self) -> Vec3:
        """+Y."""
        return (0.0, 1.0, 0.0)

    @property
    def focus(self) -> Focus:
        """The centre of the rug, at the height of the column."""
        return Focus((0.0, 0.8, 0.0), 1.5)

    def __len__(self) -> int:
        return self._options.frames

    def frame(self, index: int) -> Splats:
        """The clip at ``index / fps`` seconds."""
        parts = [batch.at(index, rows, "fourd") for _, batch, rows in self._alive(index)]
        return Splats.concatenate(parts)

    def ids(self, index: int) -> Ids:
        """A unique number for every splat of the clip."""
        firsts = [(number * self._options.births, rows) for number, _, rows in self._alive(index)]
        return np.concatenate([first + rows for first, rows in firsts]).astype(np.int32)

    def _alive(self, index: int) -> list[tuple[int, TimedSplats, NDArray[np.intp]]]:
        """Number, splats and live rows of every batch with splats alive at ``index``."""
        if not 0 <= index < len(self):
            raise IndexError(index)
        window, found = self._options.window, []
        for number in range(index + 1, index + window + 1):  # batch 0 is born ``window`` frames before the clip begins
            batch = self._batch(number)
            rows = batch.alive(index)
            if len(rows):
                found.append((number, batch, rows))
        if not found:
            newest = index + window
            found = [(newest, self._batch(newest), self._batch(newest).brightest(index))]
        return found

    def _batch(self, number: int) -> TimedSplats:
        if number not in self._batches:
            self._batches[number] = self._born(number)
            while len(self._batches) > self._options.window + 1:
                self._batches.popitem(last=False)
        return self._batches[number]

    def _born(self, number: int) -> TimedSplats:
        """The splats born in the frame before ``number - window + 1``, times in frames."""
        options = self._options
        rng = np.random.default_rng([options.seed, number])
        lives = rng.permutation(self._lives)
        centres = number - options.window + rng.uniform(0, 1, len(lives)) + lives / 2
        shares = np.array([shape.area for shape in self._shapes])
        chosen = rng.choice(len(self._shapes), len(lives), p=shares / shares.sum())
        spacing = math.sqrt(shares.sum() / options.splats)
        parts = [
            _covering(shape, centres[chosen == k] / options.fps, spacing, options, rng)
            for k, shape in enumerate(self._shapes)
        ]
        order = np.argsort(np.argsort(chosen, kind="stable"), kind="stable")
        splats = Splats.concatenate([splats for splats, _ in parts]).take(order).checked("fourd")
        motion = np.concatenate([moves for _, moves in parts])[order, None]
        peaks = 1.0 / (1.0 + np.exp(-splats.logit_opacities.astype(np.float64)))
        widths = lives / 2 / np.sqrt(np.log(peaks / FAINTEST))
        return TimedSplats(splats, centres, widths, motion, np.zeros((len(lives), 4), np.float32))

    def __reduce__(self) -> tuple[Any, ...]:
        """Workers generate the splats again."""
        return FourdScene, (self._options,)


def _lives(count: int, mean: float) -> F64:
    """``count`` lifetimes in frames with mean ``mean``: quantiles of a log-normal distribution without its longest.

    Lifetimes in a captured performance are distributed like this: a quarter of a frame's splats live for at least
    two mean lifetimes.
    """
    from scipy.special import ndtri

    lives: F64 = np.exp(SPREAD * ndtri((np.arange(count) + 0.5) / count))
    for _ in range(20):  # scaling moves some beyond the limit
        lives = np.minimum(lives / lives.mean(), LONGEST)
    return lives * mean


def _covering(
    shape: Shape, times_s: F64, spacing: float, options: FourdOptions, rng: np.random.Generator
) -> tuple[Splats, NDArray[np.float32]]:
    """Splats on ``shape`` at ``times_s`` [n], and their motion [n, 3] in metres per frame."""
    n = len(times_s)
    u, v = rng.uniform(0, 1, (2, n))
    points, (along_u, along_v) = shape.points(u, v, times_s), shape.tangents(u, v, times_s)
    turn = rng.uniform(0, np.pi, n)[:, None]
    first = _unit(along_u)
    normals = _unit(np.cross(along_u, along_v))
    side = np.cross(normals, first)
    sizes = FACES * spacing * np.exp(rng.normal(0, 0.3, (n, 3))) * np.array([1.3, 0.8, 0.15])
    rest = rng.normal(0, 0.03, (n, SH_REST_OF_DEGREE[options.degree], 3))
    if shape.gloss and options.degree:
        rest += shape.gloss * lobe(normals, SHARPNESS, options.degree)[:, 1:, None]
    shade = 0.65 + 0.35 * np.abs(normals @ np.asarray(LIGHT))
    rgb = shape.colours(u, v) * shade[:, None] + rng.normal(0, 0.03, (n, 3))
    arrays = (
        points + rng.normal(0, 0.1, (n, 1)) * spacing * normals,
        rotations.of_frames(np.cos(turn) * first + np.sin(turn) * side, np.cos(turn) * side - np.sin(turn) * first),
        np.log(sizes),
        rng.normal(2.5, 1.0, n),
        (rgb - 0.5) / SH_C0,
        rest,
    )
    splats = Splats(*(np.ascontiguousarray(array, np.float32) for array in arrays))
    return splats, (shape.velocities(u, v, times_s) / options.fps).astype(np.float32)


def _unit(vectors: F64) -> F64:
    units: F64 = vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-12)
    return units
