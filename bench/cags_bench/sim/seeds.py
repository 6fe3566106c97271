"""Other plays of the same kind: another walk, and another part of the trace, by the number of a seed.

Seed 0 is the walk and the trace as they are named. Any two settings that are compared over the same seeds see the same
walks and links, so their differences are paired.
"""

from __future__ import annotations

from array import array
from dataclasses import replace
from itertools import pairwise

from cags_common.poses import Focus, PoseTrace, open_poses, place, read_poses
from cags_shaper.trace import Trace

GOLDEN = 0.6180339887498949
"""Multiples of it modulo 1 spread evenly however many there are."""

SEED = ":seed="


def share_of(seed: int) -> float:
    """Where the part of ``seed`` begins, as a share in [0, 1); 0 of seed 0."""
    return seed * GOLDEN % 1.0


def trace_of(trace: Trace, seed: int) -> Trace:
    """``trace`` from another moment on; what lay before follows at the end of the period."""
    start_ms = round(share_of(seed) * trace.period_ms)
    if not start_ms:
        return trace
    counts = [after - before for before, after in pairwise((0, *trace.until))]
    moved = sorted(
        (time - start_ms if time > start_ms else time - start_ms + trace.period_ms, count)
        for time, count in zip(trace.times_ms, counts, strict=True)
    )
    until, total = array("q"), 0
    for _, count in moved:
        total += count
        until.append(total)
    return replace(trace, times_ms=array("q", [time for time, _ in moved]), until=until)


def walk_of(spec: str, focus: Focus, window_us: int, seed: int) -> PoseTrace:
    """The walk that ``spec`` names, or another of its kind: of a recorded one a later part, placed anew.

    ``window_us`` is how long it is looked at. Raises :class:`TraceError`.
    """
    if not seed:
        return open_poses(spec, focus, window_us=window_us)
    if spec.startswith("synthetic"):
        name, _, first = spec.partition(SEED)
        return open_poses(f"{name}{SEED}{int(first or 0) + seed}" if first.isdecimal() or not first else spec, focus)
    walk = read_poses(spec)
    start_us = round(share_of(seed) * max(walk.duration_us - window_us, 0))
    return place(walk.window(start_us, walk.duration_us), focus, window_us=window_us)
