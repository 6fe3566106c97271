"""Measuring knobs: one interleaved run over all points of all stages, so that noise falls on all alike."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from statistics import median
from typing import Any

Outcome = dict[str, float]


@dataclass(frozen=True)
class Point:
    """One setting of a knob: ``run`` does the timed work; ``judge`` turns its result into bytes and quality."""

    label: str
    run: Callable[[], Any]
    judge: Callable[[Any], Outcome]
    default: bool = False
    """Whether this is what the product ships."""


@dataclass(frozen=True)
class Stage:
    """One stage's knob: at least three points from cheap to dear, and the figure that says how good each is."""

    name: str
    knob: str
    side: str
    """Who pays: ``encoder``, ``server`` or ``client``."""
    quality: str
    """Key of the figure in what ``judge`` returns; ``error*`` and ``bytes*`` are better when lower, others higher."""
    points: tuple[Point, ...]
    repetitions: int = 5

    @property
    def higher_is_better(self) -> bool:
        """Whether the figure grows with quality; errors and bytes shrink."""
        return not self.quality.startswith(("error", "bytes"))


@dataclass
class Measured:
    """Times and outcome of one point."""

    stage: Stage
    point: Point
    times_ms: list[float] = field(default_factory=list)
    outcome: Outcome = field(default_factory=dict)

    @property
    def median_ms(self) -> float:
        """Median over the repetitions."""
        return median(self.times_ms)

    @property
    def spread_ms(self) -> float:
        """Distance between the quartiles."""
        ordered = sorted(self.times_ms)
        return ordered[(3 * len(ordered)) // 4] - ordered[len(ordered) // 4]

    def line(self) -> dict[str, Any]:
        """The point as a JSON line."""
        return {
            "stage": self.stage.name,
            "side": self.stage.side,
            "knob": self.stage.knob,
            "point": self.point.label,
            "default": self.point.default,
            "warm_up": 1,
            "repetitions": len(self.times_ms),
            "median_ms": self.median_ms,
            "spread_ms": self.spread_ms,
            "quality": self.stage.quality,
            **self.outcome,
        }


def measure(stages: Sequence[Stage], tell: Callable[[int, int], None]) -> Iterator[Measured]:
    """Warm every point up and judge it once, then time all of them round by round, telling ``tell(done, total)``."""
    measured = [Measured(stage, point) for stage in stages for point in stage.points]
    total = len(measured) + sum(one.stage.repetitions for one in measured)
    done = 0
    for one in measured:
        one.outcome = one.point.judge(one.point.run())
        tell(done := done + 1, total)
    for turn in range(max(stage.repetitions for stage in stages)):
        for one in measured:
            if turn < one.stage.repetitions:
                started = time.perf_counter()
                one.point.run()
                one.times_ms.append((time.perf_counter() - started) * 1e3)
                tell(done := done + 1, total)
    yield from measured


def pareto(measured: Sequence[Measured]) -> list[Measured]:
    """The points of one stage that no other beats in both time and quality, cheapest first."""
    sign = 1.0 if measured[0].stage.higher_is_better else -1.0
    front: list[Measured] = []
    for one in sorted(measured, key=lambda m: (m.median_ms, -sign * m.outcome[m.stage.quality])):
        if not front or sign * one.outcome[one.stage.quality] > sign * front[-1].outcome[one.stage.quality]:
            front.append(one)
    return front


def marginal_ms_per_db(front: Sequence[Measured]) -> list[tuple[str, str, float]]:
    """For neighbours on a front in dB: (from, to, milliseconds that one more dB costs)."""
    if len(front) < 2 or not front[0].stage.quality.endswith("_db"):
        return []
    key = front[0].stage.quality
    return [
        (a.point.label, b.point.label, (b.median_ms - a.median_ms) / (b.outcome[key] - a.outcome[key]))
        for a, b in pairwise(front)
    ]
