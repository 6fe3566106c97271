"""Targets of the network benchmark and the measured values."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from cags_bench.confidence import interval
from cags_bench.jsonl import JsonObject, check
from cags_bench.network.cross.experiment import judged as _cross

STEADY = "generated:steady-"

FALLING = ("lte-driving", "step")
"""Traces on which the share of missed frames has a limit."""


def checks(lines: list[JsonObject]) -> list[JsonObject]:
    """A check for every target that these lines allow."""
    by_case: dict[str, list[JsonObject]] = {}
    for line in lines:
        by_case.setdefault(str(line["case"]), []).append(line)
    out: list[JsonObject] = []
    for case, judge in (
        ("sending", _sending),
        ("sockets", _sockets),
        ("cross", _cross),
        ("first", _first),
        ("content", _content),
        ("realtime", _realtime),
        ("clients", _clients),
        ("crowd", _crowd),
        ("soak", _soak),
    ):
        if case in by_case:
            out += judge(by_case[case])
    return out


def _sending(lines: list[JsonObject]) -> list[JsonObject]:
    steady = [line for line in lines if line["trace"].startswith(STEADY)]
    mobile = [line for line in lines if line["trace"] == "generated:5g-mmwave"]
    fall = [line for line in lines if line["trace"] == "20 to 1.5 Mbps"]
    return [
        _least("utilisation on steady links", steady, "utilisation", 0.85),
        _most("median latency 2 s after a fall from 20 to 1.5 Mbps, ms", fall, "latency_ms", 120.0),
        _most("median error of the estimate on steady links", steady, "estimate_error", 0.10),
        _most("median error of the estimate on 5G mmWave", mobile, "estimate_error", 0.25),
    ]


def _sockets(lines: list[JsonObject]) -> list[JsonObject]:
    fall = [line for line in lines if line["trace"] == "20 to 1.5 Mbps"]
    return [
        _most("bytes over sockets against virtual time", lines, "difference", 0.10),
        _most("median latency over sockets 2 s after a fall from 20 to 1.5 Mbps, ms", fall, "latency_ms", 120.0),
    ]


def _content(lines: list[JsonObject]) -> list[JsonObject]:
    out = [_most("black frames", lines, "black_frames", 0)]
    recovered = [line for line in lines if line["recovery_ms"] is not None]
    if recovered:
        out.append(_most("recovery after an outage, ms", recovered, "recovery_ms", 1000.0))
    for name in FALLING:
        mine = [line for line in lines if line["policy"] == "utility" and line["trace"].startswith(f"generated:{name}")]
        if mine:
            out.append(_most(f"share of frames missed with utility on {name}", mine, "missed_share", 0.10))
    return out + _policies(lines)


FIRST_LIMITS_MS = {f"{STEADY}10": 500.0, f"{STEADY}2": 500.0}
RECOGNISABLE_LPIPS = 0.3


def _first(lines: list[JsonObject]) -> list[JsonObject]:
    out = []
    for line in lines:
        link = f"at {line['trace'].removeprefix(STEADY)} Mbps"
        if (limit_ms := FIRST_LIMITS_MS.get(line["trace"])) is not None:
            out.append(_most(f"first picture {link}, ms", [line], "first_picture_ms", limit_ms))
        if "first_lpips_restored" in line:
            out.append(_most(f"LPIPS of the first picture {link}", [line], "first_lpips_restored", RECOGNISABLE_LPIPS))
    return out


def _policies(lines: list[JsonObject]) -> list[JsonObject]:
    """Gain of ``utility`` over ``paper`` in mean PSNR, paired by play."""
    plays = {(line["trace"], line["policy"]): line["psnr_db_by_play"] for line in lines}
    gains = {
        trace: interval([_number(a) - _number(b) for a, b in zip(ours, plays[trace, "paper"], strict=True)])
        for (trace, policy), ours in plays.items()
        if policy == "utility" and (trace, "paper") in plays
    }
    out = []
    if f"{STEADY}30" in gains:
        gain = gains[f"{STEADY}30"].mean
        out.append(check("utility over paper at 30 Mbps, dB", ">= 0.5", gain, gain >= 0.5))
    if gains:
        trace, worst = min(gains.items(), key=lambda item: -math.inf if math.isnan(item[1].mean) else item[1].mean)
        value = f"{worst if worst.bounded else format(worst.mean, '+.2f')} on {trace.removeprefix('generated:')}"
        out.append(check("utility over paper at worst, dB", ">= -0.1", value, worst.mean >= -0.1))
    return out


def _realtime(lines: list[JsonObject]) -> list[JsonObject]:
    return [_most("bytes in real time against virtual time", lines, "difference", 0.10)]


def _clients(lines: list[JsonObject]) -> list[JsonObject]:
    return [_most("deadlines missed by the headless clients", lines, "deadlines_missed", 0)]


def _crowd(lines: list[JsonObject]) -> list[JsonObject]:
    return [
        _most("seconds for the crowd", lines, "seconds", 120.0),
        _most("silent sessions in the crowd", lines, "silent_sessions", 0),
    ]


def _soak(lines: list[JsonObject]) -> list[JsonObject]:
    return [
        _most("messages of the soak that did not settle", lines, "unsettled", 0),
        _most("layers of the soak that were sent again", lines, "sent_again", 0),
    ]


def _most(name: str, lines: list[JsonObject], key: str, limit: float) -> JsonObject:
    worst = _worst(max, lines, key)
    return check(name, f"<= {limit:g}", worst, worst <= limit)


def _least(name: str, lines: list[JsonObject], key: str, limit: float) -> JsonObject:
    worst = _worst(min, lines, key)
    return check(name, f">= {limit:g}", worst, worst >= limit)


def _worst(of: Callable[[list[float]], float], lines: list[JsonObject], key: str) -> float:
    """The worst value; nan, which meets no limit, if there is none or any is missing."""
    values = [_number(line.get(key)) for line in lines]
    return of(values) if values and not any(map(math.isnan, values)) else math.nan


def _number(value: Any) -> float:
    return math.nan if value is None else float(value)
