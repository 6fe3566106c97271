"""The experiment behind ``cags-bench stream``: one play, plays over several seeds, or a comparison of two settings."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from cags_bench.confidence import Interval, interval
from cags_bench.jsonl import JsonObject, check, provenance, summary
from cags_bench.stream.figures import FIGURES, HIGHER, LOWER, Figure
from cags_bench.stream.play import Play
from cags_bench.stream.settings import StreamSettings, changed
from cags_common.errors import ConfigError

BETTER, WORSE = "better", "worse"
NO_DIFFERENCE = "no difference seen"
UNSURE = "one seed is not enough"


def stream_lines(settings: StreamSettings) -> Iterator[JsonObject]:
    """One line per play, then the summary; a single play is its own summary.

    Raises :class:`CagsError`; invalid settings are refused before anything is encoded.
    """
    states = states_of(settings)
    seeds = settings.seed_list
    plays = {state: [_play(one, state, seed, settings) for seed in seeds] for state, one in states}
    for state_plays in plays.values():
        state_plays[0].check()  # seeds differ in their outputs alone
    for play in (play for state_plays in plays.values() for play in state_plays):
        play.check_outputs()
    lines: dict[str, list[JsonObject]] = {state: [] for state in plays}
    for seed in seeds:
        for state, state_plays in plays.items():
            line = state_plays[seed].line()
            if len(states) == len(seeds) == 1:
                yield {**line, "benchmark": "stream", "checks": [], **provenance()}
                return
            lines[state].append(line)
            yield {**line, "summary": False, "benchmark": "stream", "case": state, **provenance()}
    if settings.compare:
        first, second = lines
        yield _compared(settings, (first, lines[first]), (second, lines[second]))
    else:
        (only,) = lines.values()
        found = {figure.key: _as_json(interval(values)) for figure in FIGURES if (values := _values(figure, only))}
        yield summary("stream", [], seeds=len(seeds), figures=found, **_shared(only))


def states_of(settings: StreamSettings) -> list[tuple[str, StreamSettings]]:
    """Label and settings of each state to play: one, or the two of ``compare``. Raises :class:`ConfigError`."""
    if not settings.compare:
        return [("", settings)]
    name, _, both = settings.compare.partition("=")
    values = [value.strip() for value in both.split(",")]
    if len(values) != 2 or not all(values) or values[0] == values[1]:
        raise ConfigError(f"compare = {settings.compare!r} must be NAME=A,B with two values, like abr=paper,utility")
    return [(value, changed(settings, name, value)) for value in values]


def _play(settings: StreamSettings, state: str, seed: int, whole: StreamSettings) -> Play:
    words = [state.replace("/", "_").replace(":", "_")] if state else []
    words += [f"seed{seed}"] if len(whole.seed_list) > 1 else []
    return Play(settings, seed, "-".join(words))


def _values(figure: Figure, lines: Sequence[Mapping[str, Any]]) -> list[float]:
    """Values of all plays; empty if a play lacks the figure."""
    values = [value for line in lines if (value := figure.of(line)) is not None]
    return values if len(values) == len(lines) else []


def _compared(
    settings: StreamSettings, first: tuple[str, list[JsonObject]], second: tuple[str, list[JsonObject]]
) -> JsonObject:
    """The summary of a comparison: differences of the second state from the first."""
    differences, checks = {}, []
    for figure in FIGURES:
        before, after = _values(figure, first[1]), _values(figure, second[1])
        if not before or not after:
            continue
        found = interval([b - a for a, b in zip(before, after, strict=True)])
        verdict = verdict_of(figure, found)
        means = {state: math.fsum(values) / len(values) for state, values in ((first[0], before), (second[0], after))}
        differences[figure.key] = {"means": means, "difference": _as_json(found), "verdict": verdict}
        if figure.better:
            name = f"{figure.name}: {second[0]} is not worse than {first[0]}"
            checks.append(check(name, "not surely worse", f"{found}", found.bounded and verdict != WORSE))
    name = settings.compare.partition("=")[0]
    compared = {"name": name, "values": [first[0], second[0]], "seeds": len(settings.seed_list)}
    return summary("stream", checks, compare=compared, figures=differences, **_shared([*first[1], *second[1]]))


def verdict_of(figure: Figure, found: Interval) -> str:
    """Verdict on a difference, in words."""
    if not found.bounded:
        return UNSURE
    if found.low <= 0.0 <= found.high:
        return NO_DIFFERENCE
    higher = found.low > 0.0
    if figure.better in (HIGHER, LOWER):
        return BETTER if higher == (figure.better == HIGHER) else WORSE
    return "more" if higher else "less"


def _as_json(found: Interval) -> JsonObject:
    return {"mean": found.mean, "low": found.low, "high": found.high}


def _shared(lines: Sequence[Mapping[str, Any]]) -> JsonObject:
    return {key: lines[0][key] for key in ("truth", "left_out", "settings") if key in lines[0]}
