"""``cags-bench network --parts cross``: share of the link, queue and age of frames beside other traffic.

The path is the reference path of RFC 8867 (50 ms one way, a drop-tail queue of 300 ms), at 10 Mbps instead of a video
call's one or two. As in the RFC, the cases are two flows of the same kind, and two beside a long TCP flow; each
without loss and with 2 % of random loss. The sessions are the product's own and send all that its estimator allows,
over a model of TCP (:mod:`cags_bench.network.cross.tcp`). Time is virtual, so other load on the machine has no effect.
"""

from __future__ import annotations

import math
import random
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from cags_bench.confidence import interval
from cags_bench.jsonl import JsonObject, check
from cags_bench.network.cross.bottleneck import SAMPLE_US, Bottleneck, Rival, Station
from cags_bench.network.cross.congestion import RULES
from cags_bench.network.cross.tcp import Flow
from cags_bench.network.load import Arrivals
from cags_bench.parallel import in_parallel
from cags_shaper.link import Link, LinkSettings
from cags_shaper.trace import open_trace

RATE_MBPS, DELAY_US, QUEUE_MS = 10.0, 50_000, 300.0
OURS, LOSS = 2, 0.02
ALONE = "none"
SETTLE_US = 10_000_000
"""Results exclude the first seconds, in which flows find their rates."""

START_US = 1_000_000
"""All flows start within this time, at a moment given by the seed."""


@dataclass(frozen=True)
class Case:
    """Two sessions over TCP of the rule ``carrier``, beside one flow of the rule ``rival``, or alone."""

    rival: str
    carrier: str
    loss: float
    seed: int
    duration_us: int

    def figures(self) -> dict[str, float]:
        """Run the case. Times are in ms, shares relative to the link's payload bytes."""
        draw = random.Random(self.seed)  # noqa: S311 - a simulation
        starts = [round(draw.uniform(0, START_US)) for _ in range(OURS + 1)]
        queue_bytes = round(RATE_MBPS * QUEUE_MS * 125)
        settings = LinkSettings(DELAY_US, loss=self.loss, queue_bytes=queue_bytes, seed=self.seed)
        stations = [Station(Flow(RULES[self.carrier]()), start) for start in starts[:OURS]]
        rivals = [] if self.rival == ALONE else [Rival(Flow(RULES[self.rival](), endless=True), starts[-1])]
        world = Bottleneck(
            Link(open_trace(f"generated:steady-{RATE_MBPS:g}"), settings), stations, rivals, RATE_MBPS * 1e6
        )
        world.run(SETTLE_US)
        parties: list[Rival] = [*stations, *rivals]
        before = [party.flow.received_bytes for party in parties]
        world.run(self.duration_us)
        carried = RATE_MBPS / 8 * (self.duration_us - SETTLE_US)
        received = zip(parties, before, strict=True)
        shares = [(party.flow.received_bytes - earlier) / carried for party, earlier in received]
        queue_ms = [delay_us / 1e3 for at_us, delay_us in world.queue_us if at_us > SETTLE_US]
        ages_ms = np.concatenate([ages(s.log, s.start_us, SETTLE_US, self.duration_us) for s in stations]) / 1e3
        return {
            "share": float(np.mean(shares[:OURS])),
            "share_least": min(shares[:OURS]),
            "share_rival": shares[OURS] if rivals else 0.0,
            "used": sum(shares),
            "fairness": fairness(shares[:OURS]),
            "queue_ms": float(np.median(queue_ms)),
            "queue_p95_ms": float(np.percentile(queue_ms, 95)),
            "age_ms": float(np.median(ages_ms)),
            "age_p99_ms": float(np.percentile(ages_ms, 99)),
        }


def fairness(shares: Sequence[float]) -> float:
    """Jain's index: 1 if all shares are equal (even zero), 1 / n if one of n gets everything."""
    squares = len(shares) * sum(share**2 for share in shares)
    return sum(shares) ** 2 / squares if squares else 1.0


def ages(log: Arrivals, start_us: int, from_us: int, until_us: int) -> np.ndarray:
    """Time in us since the server planned the newest frame that has arrived, every :data:`SAMPLE_US`.

    Dropped and late references make it larger. Before the first arrival it is the time since the start.
    """
    arrived = np.array([at_us for at_us, _ in log.references], np.int64) + start_us
    planned = np.maximum.accumulate(arrived - np.array([latency for _, latency in log.references], np.int64))
    times = np.arange(from_us, until_us, SAMPLE_US)
    came = np.searchsorted(arrived, times, side="right")
    return np.asarray(times - np.concatenate([[start_us], planned])[came], np.float64)


def cross_lines(duration_us: int, seeds: int, workers: int) -> Iterator[JsonObject]:
    """One line per case with means and 95 % intervals over ``seeds``, and the effect of loss on the age."""
    groups = [(rival, carrier, loss) for rival in (ALONE, *RULES) for carrier in RULES for loss in (0.0, LOSS)]
    cases = [Case(*group, seed, SETTLE_US + duration_us) for group in groups for seed in range(1, seeds + 1)]
    played = iter(in_parallel(Case.figures, cases, workers))
    clean: list[dict[str, float]] = []
    for rival, carrier, loss in groups:
        runs = [next(played) for _ in range(seeds)]
        line = {"case": "cross", "rival": rival, "carrier": carrier, "loss": loss, "seeds": seeds, **_means(runs)}
        if loss:
            line |= _compared(
                [after["age_p99_ms"] / before["age_p99_ms"] for before, after in zip(clean, runs, strict=True)]
            )
        clean = runs
        yield line


def _means(runs: Sequence[dict[str, float]]) -> dict[str, Any]:
    out: dict[str, Any] = {}
    for name in runs[0]:
        found = interval([run[name] for run in runs])
        out |= {name: found.mean, f"{name}_interval": [found.low, found.high]}
    return out


def _compared(ratios: Sequence[float]) -> dict[str, Any]:
    """Geometric mean of ratios of pairs, and its interval."""
    found = interval([math.log(ratio) for ratio in ratios])
    low, high = (math.exp(bound) if math.isfinite(bound) else None for bound in (found.low, found.high))
    return {"age_p99_ratio": math.exp(found.mean), "age_p99_ratio_interval": [low, high]}


def judged(lines: Sequence[JsonObject]) -> list[JsonObject]:
    """Checks that these lines allow; the worst line decides."""
    out = []
    beside = [line for line in lines if line["rival"] != ALONE and not line["loss"]]
    fair = 1 / (OURS + 1)
    for name, key in (("each of our sessions", "share_least"), ("the other flow", "share_rival")):
        for rival in sorted({str(line["rival"]) for line in beside}):
            least = min(line[key] / fair for line in beside if line["rival"] == rival)
            out.append(check(f"least share of {name} over a fair third, {rival}", ">= 0.5", least, least >= 0.5))
    alone = [line["fairness"] for line in lines if line["rival"] == ALONE]
    if alone:
        out.append(check("fairness of two of our own (Jain)", ">= 0.9", min(alone), min(alone) >= 0.9))
    ratios = [line["age_p99_ratio"] for line in lines if line["loss"] and "age_p99_ratio" in line]
    if ratios:
        worst = max(ratios)
        out.append(check("age of frames at p99 with 2 % loss over without", "<= 2", worst, worst <= 2))
    return out


def cross_table(lines: Sequence[JsonObject]) -> str:
    """Markdown table with a row per case: shares in percent of the link's rate, times in ms."""
    head = (
        "| beside | our TCP | loss | each of ours (the lesser) | the other | queue, median / p95 "
        "| age, median / p99 | p99 over that without loss |"
    )
    rows = [head, "|" + "---|" * 8]
    for line in lines:
        low, high = line.get("age_p99_ratio_interval", (None, None))
        known = low is not None and high is not None
        ratio = f"{line['age_p99_ratio']:.2f} [{low:.2f}, {high:.2f}]" if known else ""
        other = "" if line["rival"] == ALONE else f"{line['share_rival']:.0%}"
        cells = [
            line["rival"],
            line["carrier"],
            f"{line['loss']:.0%}",
            f"{line['share']:.0%} ({line['share_least']:.0%})",
            other,
            f"{line['queue_ms']:.0f} / {line['queue_p95_ms']:.0f}",
            f"{line['age_ms']:.0f} / {line['age_p99_ms']:.0f}",
            ratio,
        ]
        rows.append("| " + " | ".join(cells) + " |")
    return "\n".join(rows) + "\n"
