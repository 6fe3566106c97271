"""Soap bubbles: objects that appear and disappear."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cags_common.splats import Splats
from cags_encoder.scenes import rotations
from cags_encoder.scenes.procedural.actors import Stage, lit
from cags_encoder.scenes.procedural.light import Lighting
from cags_encoder.scenes.procedural.splatting import Surfel

_SLOTS = 6
_LIFE_S, _PAUSE_S = 1.5, 0.7


class Bubbles:
    """Soap bubbles that leave the vase one by one, rise, and burst. Each bubble has new identities."""

    def __init__(self, count: int, degree: int, light: Lighting) -> None:
        each = max(count // _SLOTS, 8)
        k = np.arange(each) + 0.5
        y, azimuth = 1 - 2 * k / each, np.pi * (1 + 5**0.5) * k
        ring = np.sqrt(1 - y * y)
        self._normals = np.stack([ring * np.cos(azimuth), y, ring * np.sin(azimuth)], axis=1)
        self._stage = Stage(slice(0, each), _no_surfels(), light, degree)
        tangent = np.stack([-np.sin(azimuth), np.zeros(each), np.cos(azimuth)], axis=1)
        self._quats = rotations.of_frames(tangent, np.cross(self._normals, tangent))
        self._each = each

    @property
    def most(self) -> int:
        """Largest number of splats of bubbles in a frame."""
        return _SLOTS * self._each

    def ids(self, time_s: float) -> NDArray[np.int64]:
        """Identities [M] of the splats of :meth:`splats`, from 0."""
        births = [slot + _SLOTS * life for slot, life, _ in self._alive(time_s)]
        return (np.array(births, np.int64)[:, None] * self._each + np.arange(self._each)).ravel()

    def splats(self, time_s: float) -> Splats:
        """All bubbles alive at ``time_s``."""
        return Splats.concatenate([self._bubble(slot, life, age) for slot, life, age in self._alive(time_s)])

    def _alive(self, time_s: float) -> list[tuple[int, int, float]]:
        """Slot, life number and age (s) of each bubble. Lives are staggered, so some bubbles always exist."""
        period = _LIFE_S + _PAUSE_S
        turns = [(slot, time_s / period + slot / _SLOTS) for slot in range(_SLOTS)]
        return [(slot, int(t), (t % 1.0) * period) for slot, t in turns if (t % 1.0) * period < _LIFE_S]

    def _bubble(self, slot: int, life: int, age: float) -> Splats:
        turn = 2.4 * (slot + 2.6 * life)
        drift = 0.12 * age
        centre = np.array([
            -0.28 + drift * np.cos(turn) + 0.03 * np.sin(5 * age + turn),
            0.80 + 0.55 * age,
            0.02 + drift * np.sin(turn) + 0.03 * np.cos(4 * age + turn),
        ])  # fmt: skip
        radius = (0.055 + 0.03 * ((0.37 * turn) % 1.0)) * min(1.0, 0.3 + 2.5 * age)
        film = 0.55 + 0.35 * np.cos(2 * np.pi * (self._normals[:, 1:2] + turn + np.array([0.0, 0.33, 0.67])))
        points = centre + radius * self._normals
        sh0, rest = lit(self._stage, film, points, self._normals, 0.9)
        spacing = radius * np.sqrt(4 * np.pi / self._each)
        rim = np.full(self._each, -1.2)
        scales = np.log(np.tile([0.6 * spacing, 0.6 * spacing, 0.05 * spacing], (self._each, 1)))
        arrays = (points, self._quats, scales, rim, sh0, rest)
        return Splats(*(np.ascontiguousarray(array, np.float32) for array in arrays))


def _no_surfels() -> Surfel:
    none = np.zeros((0, 3))
    return Surfel(np.zeros(0, np.int64), none, none, none, none, none, none[:, :2])
