"""Measures settings moment by moment, all points of all stages interleaved, so that noise affects all equally."""

from __future__ import annotations

import time
from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass, field
from statistics import mean, median
from typing import Any

Outcome = dict[str, float]

BEST_DB = 99.0
"""PSNR of pictures that are equal."""


@dataclass(frozen=True)
class Point:
    """One value of a setting at one moment: ``run`` does the timed work, ``judge`` tells its bytes and quality."""

    label: str
    run: Callable[[], Any]
    judge: Callable[[Any], Outcome | Sequence[Outcome]]
    """One outcome, or one for each of the stage's ``moments``."""
    default: bool = False
    """Whether this is the product's default."""


@dataclass(frozen=True)
class Stage:
    """One setting, and the figure that measures quality."""

    name: str
    knob: str
    side: str
    """Which side does the work: ``encoder``, ``server`` or ``client``."""
    quality: str
    """Key of the quality in the result of ``judge``. ``error*`` and ``bytes*`` are better when lower, others when
    higher.
    """
    points: tuple[Point, ...] = ()
    """The values at one moment."""
    costs: tuple[str, ...] = ()
    """Keys of other figures that are better when lower and count beside time."""
    sized: bool = True
    """Whether the work depends on the picture's size; if not, it is measured at the first size alone."""
    moments: tuple[Hashable, ...] = ()
    """Moments that are judged, if not only the one that is measured: an encoding is seen from several cameras."""
    warm: bool = True
    """Whether a run precedes the timed ones. Encodings take seconds: they run once, and that run is timed."""

    @property
    def higher_is_better(self) -> bool:
        """Whether the figure increases with quality; errors and bytes decrease."""
        return not self.quality.startswith(("error", "bytes"))


@dataclass
class Measured:
    """One point over all moments or plays.

    Points of a stage are paired by the keys of ``outcomes`` and ``times_ms``, which name a moment or a part of a play.
    """

    stage: Stage
    label: str
    default: bool = False
    size: str = ""
    """Picture size, like ``640x480``; empty if the work does not depend on it."""
    times_ms: dict[Hashable, list[float]] = field(default_factory=dict)
    outcomes: dict[Hashable, Outcome] = field(default_factory=dict)

    @property
    def all_times_ms(self) -> list[float]:
        """Every time, in ascending order."""
        return sorted(time for times in self.times_ms.values() for time in times)

    @property
    def median_ms(self) -> float:
        """Median time over moments and repetitions."""
        return median(self.all_times_ms)

    @property
    def quartiles_ms(self) -> tuple[float, float]:
        """Times below which a quarter and three quarters of them lie."""
        ordered = self.all_times_ms
        return ordered[len(ordered) // 4], ordered[(3 * len(ordered)) // 4]

    @property
    def spread_ms(self) -> float:
        """Interquartile range of the times."""
        low_ms, high_ms = self.quartiles_ms
        return high_ms - low_ms

    @property
    def quality(self) -> float:
        """Mean quality."""
        return self.mean(self.stage.quality)

    @property
    def figures(self) -> list[str]:
        """Keys of all figures."""
        return list(dict.fromkeys(key for outcome in self.outcomes.values() for key in outcome))

    def mean(self, figure: str) -> float:
        """Mean of a figure over all moments or plays that have it."""
        return mean(outcome[figure] for outcome in self.outcomes.values() if figure in outcome)


def measure(
    stages: Sequence[Stage], moment: Hashable, size: str, repetitions: int, on_step: Callable[[int, int], None]
) -> list[Measured]:
    """Run and judge every point of one moment once, then time all of them round by round.

    Calls ``on_step(done, total)``.
    """
    made = [(point, Measured(stage, point.label, point.default, size)) for stage in stages for point in stage.points]
    timed = [(point, one) for point, one in made if one.stage.warm]
    total, done = len(made) + repetitions * len(timed), 0
    for point, one in made:
        taken_ms, result = _timed(point)
        one.outcomes |= _by_moment(point.judge(result), one.stage.moments or (moment,))
        one.times_ms[moment] = [] if one.stage.warm else [taken_ms]
        on_step(done := done + 1, total)
    for _ in range(repetitions):
        for point, one in timed:
            one.times_ms[moment].append(_timed(point)[0])
            on_step(done := done + 1, total)
    return [one for _, one in made]


def _by_moment(judged: Outcome | Sequence[Outcome], moments: Sequence[Hashable]) -> dict[Hashable, Outcome]:
    return dict(zip(moments, [judged] if isinstance(judged, dict) else judged, strict=True))


def _timed(point: Point) -> tuple[float, Any]:
    started = time.perf_counter()
    result = point.run()
    return (time.perf_counter() - started) * 1e3, result


def gathered(parts: Iterable[Sequence[Measured]]) -> list[list[Measured]]:
    """The points of all moments, one entry per point, grouped by stage and size in the order of their coming."""
    groups: dict[tuple[str, str], dict[str, Measured]] = {}
    for part in parts:
        for one in part:
            group = groups.setdefault((one.stage.name, one.size), {})
            known = group.setdefault(one.label, Measured(one.stage, one.label, one.default, one.size))
            known.default |= one.default
            known.times_ms |= one.times_ms
            known.outcomes |= one.outcomes
    return [list(group.values()) for group in groups.values()]
