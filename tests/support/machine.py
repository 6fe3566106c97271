"""A machine that draws: what a picture takes is a function of what is chosen, of noise and of a load."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

from cags_client.playback.quality import Quality, newest_due, next_due

PERIOD_US = 1e6 / 30


class Drawn(NamedTuple):
    """One picture: when it was done, of which tick, and how."""

    done_us: float
    tick: int
    media: bool
    scale: float
    permille: int
    step_us: float | None


@dataclass
class Machine:
    """Plays as a player does: one picture at a time, media frames as they are due, pictures between where they fit."""

    quality: Quality
    fixed_us: float
    pixels_us: float
    """At full resolution."""
    pixels_at: Callable[[float], float] = lambda scale: 0.2 + 0.8 * scale * scale
    noise: float = 0.0
    """Largest share by which a picture takes more or less."""
    load: Callable[[float], float] = lambda now_us: 1.0
    """Times that everything takes longer."""
    seed: int = 0
    now_us: float = 0.0
    tick: int = 0
    drawn: list[Drawn] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._rng = random.Random(self.seed)

    def play(self, seconds: float) -> list[Drawn]:
        """What is drawn meanwhile."""
        end_us, first = self.now_us + seconds * 1e6, len(self.drawn)
        period_us, never = self.quality.period_us, 1 << 40
        while self.now_us < end_us:
            tick = next_due(self.tick, never, self.quality.permille)
            self.now_us = max(self.now_us, tick * period_us)
            tick = newest_due(tick, never, self.quality.permille, lambda each: each * period_us <= self.now_us)
            self.tick = tick + 1
            self._draw(tick, media=True)
            self._draw_between(tick * period_us, next_due(self.tick, never, self.quality.permille) * period_us)
        return self.drawn[first:]

    def _draw_between(self, from_us: float, to_us: float) -> None:
        step_us, due_us = self.quality.step_us, from_us
        while step_us is not None and (due_us := due_us + step_us) <= to_us - 0.25 * step_us:
            if self.now_us >= due_us + step_us:
                continue
            self.now_us = max(self.now_us, due_us)
            if not self.quality.fits(round(self.now_us), to_us):
                return
            self._draw(self.tick - 1, media=False)

    def _draw(self, tick: int, *, media: bool) -> None:
        quality = self.quality
        scale, permille, step_us = quality.scale, quality.permille, quality.step_us
        times = self.load(self.now_us) * (1 + self.noise * self._rng.uniform(-1, 1))
        pixels_us, fixed_us = (times * us for us in (self.pixels_us * self.pixels_at(scale), self.fixed_us))
        self.now_us += pixels_us + fixed_us
        quality.observe(round(self.now_us), pixels_us + fixed_us, pixels_us, media=media)
        self.drawn.append(Drawn(self.now_us, tick, media, scale, permille, step_us))
