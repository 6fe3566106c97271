"""Network traces made by rule: shapes (steady, step, sawtooth, blackout) and random models of mobile links.

The models are Markov chains of a few conditions, each with a mean rate, a spread that drifts slowly, and a mean stay.
Their figures follow published measurements of such links in kind (5G mmWave: above 150 Mbps in line of sight, blockage,
outages of seconds; LTE while driving: 1-60 Mbps, handovers of under a second); none is fitted to one recording.
"""

from __future__ import annotations

import bisect
import math
import random
from collections.abc import Callable
from dataclasses import dataclass, field, replace

from cags_common.errors import TraceError

STEADY_MBPS = (30, 60, 90, 120, 150)
"""Steady rates that are shipped; ``steady-N`` works for any."""


@dataclass(frozen=True)
class RateTable:
    """Rate ``mbps[i]`` holds from ``times_s[i]`` until the next row, the last one until ``end_s``."""

    name: str
    times_s: tuple[float, ...]
    mbps: tuple[float, ...]
    end_s: float

    def to_csv(self) -> str:
        """Rows ``time_s,mbps``; a last row repeats the last rate so that a reader knows how long it holds."""
        step = self.end_s - self.times_s[-1]
        rows = zip(self.times_s, self.mbps, strict=True)
        body = "".join(f"{t:.3f},{m:.4f}\n" for t, m in rows)
        if len(self.times_s) > 1 and math.isclose(step, self.times_s[-1] - self.times_s[-2], abs_tol=1e-6):
            return "time_s,mbps\n" + body
        half = step / 2  # two equal rows, so that the last lasts as long as the one before it
        return "time_s,mbps\n" + body + f"{self.times_s[-1] + half:.3f},{self.mbps[-1]:.4f}\n"


@dataclass(frozen=True)
class Condition:
    """A state of a mobile link."""

    mean_mbps: float
    spread_mbps: float
    mean_stay_s: float
    to: dict[str, float] = field(default_factory=dict)
    """Weights of the conditions that may follow."""


MMWAVE = {
    "sight": Condition(190.0, 35.0, 14.0, {"blocked": 0.8, "outage": 0.2}),
    "blocked": Condition(85.0, 25.0, 6.0, {"sight": 0.7, "outage": 0.3}),
    "outage": Condition(4.0, 2.0, 2.5, {"sight": 0.3, "blocked": 0.7}),
}
LTE = {
    "near": Condition(38.0, 9.0, 12.0, {"middle": 1.0}),
    "middle": Condition(20.0, 6.0, 15.0, {"near": 0.45, "edge": 0.35, "handover": 0.2}),
    "edge": Condition(5.0, 2.5, 8.0, {"middle": 0.5, "handover": 0.5}),
    "handover": Condition(0.4, 0.3, 0.7, {"near": 0.5, "middle": 0.5}),
}


def markov(conditions: dict[str, Condition], start: str, step_s: float, seed: int, duration_s: float) -> list[float]:
    """Rates in Mbps at steps of ``step_s``: within a condition an AR(1) process around its mean, never below 0.1."""
    rng = random.Random(seed)  # noqa: S311 - a simulation, not a secret
    now, drift, rates = start, 0.0, []
    for _ in range(max(round(duration_s / step_s), 1)):
        state = conditions[now]
        drift = 0.8 * drift + 0.6 * rng.gauss(0.0, 1.0)  # stationary variance 1
        rates.append(max(state.mean_mbps + state.spread_mbps * drift, 0.1))
        if rng.random() < step_s / state.mean_stay_s:
            now = rng.choices(list(state.to), weights=list(state.to.values()))[0]
    return rates


def _rows(name: str, step_s: float, rates: list[float]) -> RateTable:
    times = tuple(round(i * step_s, 6) for i in range(len(rates)))
    return RateTable(name, times, tuple(rates), round(len(rates) * step_s, 6))


def _mmwave(seed: int, duration_s: float) -> RateTable:
    return _rows("5g-mmwave", 0.5, markov(MMWAVE, "sight", 0.5, seed, duration_s))


def _lte(seed: int, duration_s: float) -> RateTable:
    return _rows("lte-driving", 0.25, markov(LTE, "middle", 0.25, seed, duration_s))


def _step(_seed: int, duration_s: float) -> RateTable:
    """20 and 1.5 Mbps in turn, 15 s each."""
    count = max(round(duration_s / 15.0), 1)
    return _rows("step", 15.0, [20.0 if i % 2 == 0 else 1.5 for i in range(count)])


def _sawtooth(_seed: int, duration_s: float) -> RateTable:
    """Rising from 10 to 120 Mbps in 20 s, then falling at once."""
    return _rows("sawtooth", 0.5, [10.0 + 110.0 * (i % 40) / 39 for i in range(max(round(duration_s / 0.5), 1))])


def _blackout(_seed: int, duration_s: float) -> RateTable:
    """60 Mbps with 3 s of nothing from 10 s on, every 30 s."""
    count = max(round(duration_s), 1)
    return _rows("blackout", 1.0, [0.0 if 10 <= i % 30 < 13 else 60.0 for i in range(count)])


OPTIONS = {"seed": (0.0, 2.0**31), "duration_s": (0.1, 3600.0), "start_s": (0.0, 3600.0)}
"""Options of a generated trace, and their bounds."""


@dataclass(frozen=True)
class Model:
    """How a named trace is made, and how long it is unless told otherwise."""

    make: Callable[[int, float], RateTable]
    duration_s: float


MODELS: dict[str, Model] = {
    "5g-mmwave": Model(_mmwave, 120.0),
    "lte-driving": Model(_lte, 120.0),
    "step": Model(_step, 60.0),
    "sawtooth": Model(_sawtooth, 60.0),
    "blackout": Model(_blackout, 30.0),
}


def generate(spec: str) -> RateTable:
    """The trace of ``NAME[:seed=N][:duration_s=N][:start_s=N]``. Raises :class:`TraceError` for what is not known."""
    name, *options = spec.split(":")
    values = _options(spec, options)
    if name.startswith("steady-"):
        rate = _number(spec, name.removeprefix("steady-"), 0.01, 10_000.0)
        return RateTable(name, (0.0,), (rate,), values.get("duration_s", 1.0))
    model = MODELS.get(name)
    if model is None:
        known = ", ".join([*MODELS, "steady-N (N Mbps)"])
        raise TraceError(f"generated:{spec}: unknown trace {name!r}; known: {known}")
    table = model.make(int(values.get("seed", 1)), values.get("duration_s", model.duration_s))
    return replace(turned(table, values.get("start_s", 0.0)), name=name)


def turned(table: RateTable, start_s: float) -> RateTable:
    """The same period, begun ``start_s`` into it; what came before follows at its end."""
    start_s %= table.end_s
    if not start_s:
        return table
    first = bisect.bisect_right(table.times_s, start_s) - 1
    times = [0.0, *(t - start_s for t in table.times_s[first + 1 :])]
    rates = list(table.mbps[first:])
    times += [t + table.end_s - start_s for t in table.times_s if t < start_s]
    rates += [rate for t, rate in zip(table.times_s, table.mbps, strict=True) if t < start_s]
    return RateTable(table.name, tuple(times), tuple(rates), table.end_s)


def _options(spec: str, options: list[str]) -> dict[str, float]:
    values: dict[str, float] = {}
    for option in options:
        key, _, text = option.partition("=")
        if key not in OPTIONS:
            raise TraceError(f"generated:{spec}: unknown option {option!r}; known: {', '.join(OPTIONS)} (=N)")
        values[key] = _number(spec, text, *OPTIONS[key])
    return values


def _number(spec: str, text: str, low: float, high: float) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not low <= value <= high:
        raise TraceError(f"generated:{spec}: {text!r} must be a number in [{low:g}, {high:g}]")
    return value
