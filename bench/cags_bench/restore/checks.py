"""What the project asks of alignment and restoration, judged from the lines of a run.

Every check speaks only of what the run holds; one whose conditions did not occur is left out.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from statistics import mean, median

from cags_bench.jsonl import JsonObject, check

CLOSED_FORM = ("affine", "sirt + affine")
CORRECTING = (*CLOSED_FORM, "lite", "srresnet")
BASELINES = ("sr-align-ref", "cr-no-ref", "paper")

MIDDLE_DB = (24.0, 29.0)
"""What counts as the middle of the ladder: PSNR of the distorted picture over covered pixels."""

FULL_FRAME = 0.95
"""Share of covered pixels from which on a view is that of a room and not of an object."""

EXACT, LEAST_LOST_DEG = "0/0", 5.0


def checks_of(lines: Sequence[JsonObject]) -> list[JsonObject]:
    """The targets that this run can speak of; judged with references as they are shipped."""
    shipped = [x for x in lines if x["reference"] == "footprint"] or list(lines)
    return [*_gains(shipped), *_kept(shipped), *_least(shipped), *_against(shipped), *_references(lines)]


def gain(line: JsonObject) -> float:
    """Of the method over the distorted picture, dB over covered pixels."""
    return float(line["psnr_covered_db"] - line["distorted_psnr_covered_db"])


def _gains(lines: Sequence[JsonObject]) -> Iterator[JsonObject]:
    low, high = MIDDLE_DB
    for name in CLOSED_FORM:
        base = [gain(x) for x in _of(lines, name) if x["lod_share"] == 0]
        if base:
            yield check(f"{name}: gain at the base LoD", ">= +4.5 dB", mean(base), mean(base) >= 4.5)
        middle = [x for x in _of(lines, name) if low <= x["distorted_psnr_covered_db"] <= high]
        for what, target, chosen in (
            ("an object", 2.0, [gain(x) for x in middle if x["covered"] < FULL_FRAME]),
            ("a full frame", 5.0, [gain(x) for x in middle if x["covered"] >= FULL_FRAME]),
        ):
            if chosen:
                title = f"{name}: gain where distorted is {low:g}-{high:g} dB, {what}"
                yield check(title, f">= +{target:g} dB", mean(chosen), mean(chosen) >= target)


def _kept(lines: Sequence[JsonObject]) -> Iterator[JsonObject]:
    """Share of the gain at the base LoD that is left under each large error of the pose."""
    for name in CLOSED_FORM:
        base = [x for x in _of(lines, name) if x["lod_share"] == 0]
        exact = [gain(x) for x in base if x["error"] == EXACT]
        large = dict.fromkeys(x["error"] for x in base if x["error"] == "predicted" or _degrees(x) >= LEAST_LOST_DEG)
        for error in large if exact else ():
            share = mean(gain(x) for x in base if x["error"] == error) / max(mean(exact), 1e-6)
            where = "the predicted pose" if error == "predicted" else f"an error of {error} (degrees/cm)"
            yield check(f"{name}: gain kept at {where}, base LoD", ">= 0.8", share, share >= 0.8)


def _degrees(line: JsonObject) -> float:
    return float(str(line["error"]).partition("/")[0])


def _least(lines: Sequence[JsonObject]) -> Iterator[JsonObject]:
    for name in CORRECTING:
        gains = [gain(x) for x in _of(lines, name)]
        top = [gain(x) for x in _of(lines, name) if x["lod_share"] == 1]
        if gains:
            yield check(f"{name} never lower than distorted", ">= -0.1 dB each", min(gains), min(gains) >= -0.1)
        if top:
            yield check(f"{name} at the top of the ladder", ">= -0.1 dB each", min(top), min(top) >= -0.1)


def _against(lines: Sequence[JsonObject]) -> Iterator[JsonObject]:
    """Mean differences below the top of the ladder: at the top nothing is left to restore."""
    below = [x for x in lines if x["lod_share"] < 1] or lines
    wanted = [("lite", "affine", 0.7), ("lite", "srresnet", -0.3)]
    wanted += [(name, other, 0.0) for name in CORRECTING for other in BASELINES]
    for name, other, by_db in wanted:
        ours, theirs = _of(below, name), _of(below, other)
        if ours and theirs:
            value = mean(x["psnr_covered_db"] for x in ours) - mean(x["psnr_covered_db"] for x in theirs)
            yield check(f"{name} against {other}", f">= {by_db:+g} dB", value, value >= by_db)


def _references(lines: Sequence[JsonObject]) -> Iterator[JsonObject]:
    """The shipped way to draw references against the paper's: what the footprint is there for."""
    ours, plain = ([x for x in _of(lines, "affine") if x["reference"] == kind] for kind in ("footprint", "plain"))
    if ours and plain:
        value = mean(map(gain, ours)) - mean(map(gain, plain))
        yield check("affine: the client's footprint against a plain reference", ">= 0 dB", value, value >= 0)


def time_checks(lines: Sequence[JsonObject], threads: int) -> list[JsonObject]:
    """Times of single stages at 1600x1200."""
    out: list[JsonObject] = []
    # "aligned" has its colours with the alignment; how the bench lays them over the picture does not count
    limits = [("aligned", "align_ms", 6.0), ("affine", "restore_ms", 10.0), ("lite", "restore_ms", 33.0)]
    for name, stage, limit in limits:
        found = [x[stage] for x in _of(lines, name) if x["size"] == "1600x1200"]
        if found:
            title = f"{'alignment with erosion' if name == 'aligned' else name} at 1600x1200, {threads} threads"
            out.append(check(title, f"<= {limit:g} ms", median(found), median(found) <= limit))
    return out


def _of(lines: Iterable[JsonObject], name: str) -> list[JsonObject]:
    return [x for x in lines if x["method"] == name]
