"""The procedural room as a sequence of frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cags_common.geometry import Vec3
from cags_common.settings import check_settings, setting
from cags_common.splats import Ids, Splats
from cags_encoder.scenes.procedural.actors import cast
from cags_encoder.scenes.procedural.bubbles import Bubbles
from cags_encoder.scenes.procedural.room import furnish, lighting
from cags_encoder.scenes.procedural.splatting import divide, splats_of
from cags_encoder.scenes.procedural.textures import Noise
from cags_encoder.scenes.source import DEFAULT_FPS, MAX_FRAMES, Focus

MIN_SPLATS = 500
"""Fewer do not show a room. Below some 5,000 the smallest things are left out."""


@dataclass(frozen=True)
class ProceduralSettings:
    """Size and length of the procedural room."""

    size: int = setting(60_000, "number of splats", low=MIN_SPLATS, high=4_000_000)
    frames: int = setting(60, "number of frames", low=1, high=MAX_FRAMES)
    seed: int = setting(1, "seed of everything random", low=0, high=2**31 - 1)
    fps: float = setting(DEFAULT_FPS, "frames a second", low=1.0, high=240.0)
    degree: int = setting(2, "spherical-harmonics degree of glossy things", low=0, high=3)

    def __post_init__(self) -> None:
        check_settings(self)


class ProceduralScene:
    """A room of 4.8 x 2.6 x 4.8 m, y up. The same settings give the same frames, bit by bit."""

    def __init__(self, settings: ProceduralSettings) -> None:
        self._settings = settings
        rng = np.random.default_rng(settings.seed)
        noise, light = Noise(rng), lighting()
        self._bubbles = Bubbles(settings.size // 60, settings.degree, light)
        patches = furnish(noise, rng)
        actors = cast(noise, rng)
        moving = [patch for actor in actors for patch in actor.patches]
        surfels = divide([*patches, *moving], settings.size - self._bubbles.most, light)
        self._rest = splats_of([*patches, *moving], surfels, light, settings.degree).checked("procedural")
        ends = len(patches) + np.cumsum([len(actor.patches) for actor in actors])
        self._acts = []
        for actor, end in zip(actors, ends, strict=True):
            rows = slice(*(int(r) for r in np.searchsorted(surfels.patch, [end - len(actor.patches), end])))
            self._acts.append(actor.prepared(rows, surfels, light, settings.degree))

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
        """The table in the middle; at 2.5 radii one still stands inside the room."""
        return Focus((0.0, 0.95, 0.0), 0.85)

    def __len__(self) -> int:
        return self._settings.frames

    def frame(self, index: int) -> Splats:
        """The room at ``index / fps`` seconds: all splats that stay, then the bubbles of that moment."""
        time_s = self._time(index)
        columns = {name: array.copy() for name, array in self._rest.arrays()}
        for act in self._acts:
            act(time_s, columns)
        return Splats.concatenate([Splats(**columns), self._bubbles.splats(time_s)]).checked("procedural")

    def ids(self, index: int) -> Ids:
        """Rows of all that stays, then a new identity for every bubble that is ever blown."""
        bubbles = self._bubbles.ids(self._time(index)) + len(self._rest)
        return np.concatenate([np.arange(len(self._rest)), bubbles]).astype(np.int32)

    def _time(self, index: int) -> float:
        if not 0 <= index < len(self):
            raise IndexError(index)
        return index / self._settings.fps
