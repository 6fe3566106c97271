"""Measures settings in one interleaved run over all points of all stages, so that noise affects all equally."""

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
    """One value of a setting: ``run`` does the timed work; ``judge`` turns its result into bytes and quality."""

    label: str
    run: Callable[[], Any]
    judge: Callable[[Any], Outcome]
    default: bool = False
    """Whether this is the product's default."""


@dataclass(frozen=True)
class Stage:
    """One setting with at least three values from cheap to expensive, and the figure that measures quality."""

    name: str
    knob: str
    side: str
    """Which side does the work: ``encoder``, ``server`` or ``client``."""
    quality: str
    """Key of the quality in the result of ``judge``. ``error*`` and ``bytes*`` are better when lower, others when
    higher.
    """
    points: tuple[Point, ...]
    repetitions: int = 5

    @property
    def higher_is_better(self) -> bool:
        """Whether the figure increases with quality; errors and bytes decrease."""
        return not self.quality.startswith(("error", "bytes"))


@dataclass
class Measured:
    """Times and result of one point."""

    stage: Stage
    point: Point
    times_ms: list[float] = field(default_factory=list)
    outcome: Outcome = field(default_factory=dict)

    @property
    def median_ms(self) -> float:
        """Median time over the repetitions."""
        return median(self.times_ms)

    @property
    def spread_ms(self) -> float:
        """Interquartile range of the times."""
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


def measure(stages: Sequence[Stage], on_step: Callable[[int, int], None]) -> Iterator[Measured]:
    """Warm up and judge every point once, then time all of them round by round. Calls ``on_step(done, total)``."""
    measured = [Measured(stage, point) for stage in stages for point in stage.points]
    total = len(measured) + sum(one.stage.repetitions for one in measured)
    done = 0
    for one in measured:
        one.outcome = one.point.judge(one.point.run())
        on_step(done := done + 1, total)
    for turn in range(max(stage.repetitions for stage in stages)):
        for one in measured:
            if turn < one.stage.repetitions:
                started = time.perf_counter()
                one.point.run()
                one.times_ms.append((time.perf_counter() - started) * 1e3)
                on_step(done := done + 1, total)
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
    """For neighbours on a front in dB: (from, to, milliseconds per additional dB)."""
    if len(front) < 2 or not front[0].stage.quality.endswith("_db"):
        return []
    key = front[0].stage.quality
    return [
        (a.point.label, b.point.label, (b.median_ms - a.median_ms) / (b.outcome[key] - a.outcome[key]))
        for a, b in pairwise(front)
    ]
