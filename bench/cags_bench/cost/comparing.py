"""Compares the points of a stage: intervals of means and of paired differences to the default, and Pareto fronts."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from statistics import median
from typing import Any

from cags_bench.confidence import Interval, interval
from cags_bench.cost.engine import Measured

BETTER, WORSE, UNSURE = "better", "worse", ""

TIME = "ms"
"""Name of the cost that every stage has."""


def default_of(group: Sequence[Measured]) -> Measured | None:
    """The product's default among the points of a stage."""
    return next((one for one in group if one.default), None)


def quality_of(one: Measured) -> Interval:
    """Mean quality and its 95 % interval over moments, or parts of plays."""
    return interval([outcome[one.stage.quality] for outcome in one.outcomes.values()])


def gain(one: Measured, other: Measured) -> Interval:
    """Mean gain in quality over ``other`` and its 95 % interval, paired by moment; positive is better."""
    sign, key = (1.0 if one.stage.higher_is_better else -1.0), one.stage.quality
    return interval([sign * (ours[key] - theirs[key]) for ours, theirs in _pairs(one.outcomes, other.outcomes)])


def cost_ratio(one: Measured, other: Measured, cost: str = TIME) -> Interval:
    """Mean ratio of a cost to that of ``other`` and its 95 % interval, paired by moment.

    Unbounded where ``other`` has a moment without cost.
    """
    if cost == TIME:
        pairs = [(median(ours), median(theirs)) for ours, theirs in _pairs(one.times_ms, other.times_ms)]
    else:
        known = _pairs(one.outcomes, other.outcomes)
        pairs = [(ours[cost], theirs[cost]) for ours, theirs in known if cost in ours and cost in theirs]
    return interval([ours / theirs if theirs else math.nan for ours, theirs in pairs])


def _pairs(ours: Any, theirs: Any) -> list[tuple[Any, Any]]:
    return [(ours[key], theirs[key]) for key in ours if key in theirs]


def verdict(found: Interval) -> str:
    """Whether a gain is surely above or below zero, or neither."""
    if found.low > 0:
        return BETTER
    return WORSE if found.high < 0 else UNSURE


def beats(one: Measured, other: Measured) -> bool:
    """Whether ``one`` is surely no worse than ``other`` in quality and every cost, and surely better in one."""
    more = gain(one, other)
    costs = [cost_ratio(one, other, cost) for cost in (TIME, *one.stage.costs)]
    no_worse = more.low >= 0 and all(cost.high <= 1 for cost in costs)
    return no_worse and (more.low > 0 or any(cost.high < 1 for cost in costs))


def beaten_by(group: Sequence[Measured]) -> list[Measured]:
    """Points of a stage that beat the default; none if it lies on the front, or within noise of it."""
    default = default_of(group)
    return [] if default is None else [one for one in group if one is not default and beats(one, default)]


def pareto(group: Sequence[Measured]) -> list[Measured]:
    """The points of one stage that no other beats in both median time and mean quality, cheapest first."""
    sign = 1.0 if group[0].stage.higher_is_better else -1.0
    front: list[Measured] = []
    for one in sorted(group, key=lambda m: (m.median_ms, -sign * m.quality)):
        if not front or sign * one.quality > sign * front[-1].quality:
            front.append(one)
    return front


def neighbours(group: Sequence[Measured]) -> tuple[Measured | None, Measured | None]:
    """The next cheaper and the next dearer point than the default, of those on the front; None where there is none."""
    default, front = default_of(group), pareto(group)
    if default is None:
        return None, None
    others = [one for one in front if one is not default]
    cheaper = [one for one in others if one.median_ms < default.median_ms]
    dearer = [one for one in others if one.median_ms >= default.median_ms]
    return (cheaper[-1] if cheaper else None), (dearer[0] if dearer else None)


def marginal_ms_per_db(front: Sequence[Measured]) -> list[tuple[str, str, float]]:
    """For neighbours on a front in dB: (from, to, milliseconds per additional dB)."""
    if len(front) < 2 or not front[0].stage.quality.endswith("_db"):
        return []
    return [(a.label, b.label, (b.median_ms - a.median_ms) / (b.quality - a.quality)) for a, b in pairwise(front)]


def line(one: Measured, default: Measured | None) -> dict[str, Any]:
    """The point as a JSON line; ``gain`` and ``times`` compare it with the default of its stage."""
    found = quality_of(one)
    out: dict[str, Any] = {
        "stage": one.stage.name,
        "side": one.stage.side,
        "knob": one.stage.knob,
        "size": one.size,
        "point": one.label,
        "default": one.default,
        "runs": len(one.all_times_ms),
        "median_ms": one.median_ms,
        "spread_ms": one.spread_ms,
        "quality": one.stage.quality,
        "observations": len(one.outcomes),
        "quality_low": found.low,
        "quality_high": found.high,
        **{key: one.mean(key) for key in one.figures},
    }
    if default is None or default is one:
        return out
    more, slower = gain(one, default), cost_ratio(one, default)
    return out | {
        **_bounds("gain", more),
        "verdict": verdict(more),
        **_bounds("times", slower),
    }


def _bounds(name: str, found: Interval) -> dict[str, float]:
    return {name: found.mean, f"{name}_low": found.low, f"{name}_high": found.high}
