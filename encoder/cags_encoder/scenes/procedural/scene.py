"""The procedural room as a sequence of frames."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from cags_common.geometry import Vec3
from cags_common.settings import check_settings, setting
from cags_common.splats import Ids, Splats
from cags_encoder.scenes.procedural.actors import Actor, cast
from cags_encoder.scenes.procedural.bubbles import Bubbles
from cags_encoder.scenes.procedural.patches import Patch
from cags_encoder.scenes.procedural.room import furnish, lighting
from cags_encoder.scenes.procedural.splatting import Surfel, divide, splats_of
from cags_encoder.scenes.procedural.textures import Noise
from cags_encoder.scenes.source import DEFAULT_FPS, MAX_FRAMES, Focus

MIN_SPLATS = 500
"""With fewer splats no room is recognisable. Below about 5,000 the smallest objects are left out."""

KEPT_SPLATS = 20_000
"""Layouts of rooms up to this size are cached in memory."""


@dataclass(frozen=True)
class ProceduralSettings:
    """Size and length of the procedural room."""

    size: int = setting(60_000, "number of splats", low=MIN_SPLATS, high=4_000_000)
    frames: int = setting(60, "number of frames", low=1, high=MAX_FRAMES)
    seed: int = setting(1, "seed of everything random", low=0, high=2**31 - 1)
    fps: float = setting(DEFAULT_FPS, "frames per second", low=1.0, high=240.0)
    degree: int = setting(2, "spherical-harmonics degree of glossy objects", low=0, high=3)

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(frozen=True, eq=False)
class Layout:
    """Contents of a room and their division into splats; immutable."""

    patches: tuple[Patch, ...]
    """Patches of the furniture, then of the actors at rest."""
    actors: tuple[Actor, ...]
    surfels: Surfel


def layout(seed: int, count: int) -> Layout:
    """Furnish and light a room of ``count`` splats; takes a second or two for any number."""
    rng = np.random.default_rng(seed)
    noise = Noise(rng)
    patches = furnish(noise, rng)
    actors = cast(noise, rng)
    patches += [patch for actor in actors for patch in actor.patches]
    return Layout(tuple(patches), tuple(actors), divide(patches, count, lighting()))


kept_layout = lru_cache(maxsize=8)(layout)
""":func:`layout` with a cache, so that clips of one room share it."""


class ProceduralScene:
    """A room of 4.8 x 2.6 x 4.8 m, y up. The same settings give bit-identical frames."""

    def __init__(self, settings: ProceduralSettings) -> None:
        self._settings, light = settings, lighting()
        self._bubbles = Bubbles(settings.size // 60, settings.degree, light)
        lay_out = kept_layout if settings.size <= KEPT_SPLATS else layout
        room = lay_out(settings.seed, settings.size - self._bubbles.most)
        self._rest = splats_of(list(room.patches), room.surfels, light, settings.degree).checked("procedural")
        firsts = len(room.patches) - np.cumsum([len(actor.patches) for actor in room.actors[::-1]])[::-1]
        self._acts = []
        for actor, first in zip(room.actors, firsts, strict=True):
            rows = slice(*(int(r) for r in np.searchsorted(room.surfels.patch, [first, first + len(actor.patches)])))
            self._acts.append(actor.prepared(rows, room.surfels, light, settings.degree))

    @property
    def name(self) -> str:
        """Always ``procedural``."""
        return "procedural"

    @property
    def fps(self) -> float:
        """Frames per second."""
        return self._settings.fps

    @property
    def up(self) -> Vec3:
        """+Y."""
        return (0.0, 1.0, 0.0)

    @property
    def focus(self) -> Focus:
        """The table in the centre; 2.5 radii are still inside the room."""
        return Focus((0.0, 0.95, 0.0), 0.85)

    def __len__(self) -> int:
        return self._settings.frames

    def frame(self, index: int) -> Splats:
        """The room at ``index / fps`` seconds: all permanent splats, then the bubbles at that time."""
        time_s = self._time(index)
        columns = {name: array.copy() for name, array in self._rest.arrays()}
        for act in self._acts:
            act(time_s, columns)
        return Splats.concatenate([Splats(**columns), self._bubbles.splats(time_s)]).checked("procedural")

    def ids(self, index: int) -> Ids:
        """Rows of the permanent splats, then unique identities for the bubbles."""
        bubbles = self._bubbles.ids(self._time(index)) + len(self._rest)
        return np.concatenate([np.arange(len(self._rest)), bubbles]).astype(np.int32)

    def _time(self, index: int) -> float:
        if not 0 <= index < len(self):
            raise IndexError(index)
        return index / self._settings.fps
