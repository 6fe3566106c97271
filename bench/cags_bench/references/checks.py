"""Targets for references, checked from the lines of a run and of an earlier state."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from statistics import mean

from cags_bench.jsonl import JsonObject, check
from cags_bench.references.methods import OURS

GAIN_DB, LEAST_DB, FEWER_BYTES, WORSE_FRAMES = 1.0, -0.3, 0.3, 0.001

LABEL = ("scene", "link_mbps", "poses", "frames", "size")


@dataclass(frozen=True)
class Pair:
    """Results of the default method and another for the same case."""

    ours: JsonObject
    other: JsonObject

    @property
    def gain_db(self) -> float:
        """Gain in PSNR over covered pixels."""
        return float(self.ours["psnr_db"]) - float(self.other["psnr_db"])

    @property
    def name(self) -> str:
        """The case as text."""
        return f"{self.ours['scene']}, {self.ours['link_mbps']:g} Mbps, {self.ours['poses']}"


def checks_of(lines: Sequence[JsonObject], earlier: Sequence[JsonObject]) -> list[JsonObject]:
    """Checks against the earlier state and against the other methods of this run."""
    pairs = pairs_of(lines, earlier)
    return [*(_against_before(pairs) if pairs else ()), *_against_others(lines)]


def pairs_of(lines: Sequence[JsonObject], others: Sequence[JsonObject]) -> list[Pair]:
    """Pairs of the default method's lines and those of ``others`` for the same case."""
    by_case = {_key(line): line for line in others}
    return [Pair(x, by_case[_key(x)]) for x in lines if x["method"] == OURS and _key(x) in by_case]


def _key(line: JsonObject) -> tuple[object, ...]:
    return tuple(line[name] for name in LABEL)


def _against_before(pairs: Sequence[Pair]) -> Iterator[JsonObject]:
    gains = [pair.gain_db for pair in pairs]
    yield check("mean gain over the state before, dB", f">= {GAIN_DB:g}", round(mean(gains), 2), mean(gains) >= GAIN_DB)
    worst = min(pairs, key=lambda pair: pair.gain_db)
    value = f"{worst.gain_db:.2f} ({worst.name})"
    yield check("no case below the state before, dB", f">= {LEAST_DB:g} each", value, worst.gain_db >= LEAST_DB)
    flickering = [p.name for p in pairs if float(p.ours["flicker"]) >= float(p.other["flicker"])]
    yield check("cases that flicker as much as before", "none", flickering, not flickering)
    ours, before = (sum(int(x["reference_bytes"]) for x in side) for side in zip(*map(_both, pairs), strict=True))
    fewer = 1 - ours / max(before, 1)
    yield check("reference bytes less than before", f">= {FEWER_BYTES:g}", round(fewer, 3), fewer >= FEWER_BYTES)


def _both(pair: Pair) -> tuple[JsonObject, JsonObject]:
    return pair.ours, pair.other


def _against_others(lines: Sequence[JsonObject]) -> Iterator[JsonObject]:
    ours = [line for line in lines if line["method"] == OURS]
    for method in ("difference", "picture", "none", "published"):
        pairs = pairs_of(ours, [line for line in lines if line["method"] == method])
        if pairs:
            worst = min(pairs, key=lambda pair: pair.gain_db)
            value = f"{worst.gain_db:.2f} ({worst.name})"
            yield check(
                f"{OURS} against {method}, worst case, dB", f">= {LEAST_DB:g}", value, worst.gain_db >= LEAST_DB
            )
    if ours:
        share = mean(float(line["worse_0.5_db_share"]) for line in ours)
        yield check(
            "frames 0.5 dB worse than the client's own splats",
            f"<= {WORSE_FRAMES:g}",
            round(share, 4),
            share <= WORSE_FRAMES,
        )
