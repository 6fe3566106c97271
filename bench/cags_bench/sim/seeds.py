"""Variations of a play: a seed selects another walk and another part of the trace.

Seed 0 is the named walk and trace. Settings that are compared over the same seeds get the same walks and links, so
their differences are paired.
"""

from __future__ import annotations

from array import array
from dataclasses import replace
from itertools import pairwise

from cags_common.poses import Focus, PoseTrace, open_poses, place, read_poses
from cags_shaper.trace import Trace

GOLDEN = 0.6180339887498949
"""Multiples of the golden ratio modulo 1 are evenly distributed for any number of seeds."""

SEED = ":seed="


def share_of(seed: int) -> float:
    """Start of the part for ``seed``, as a share in [0, 1); 0 for seed 0."""
    return seed * GOLDEN % 1.0


def trace_of(trace: Trace, seed: int) -> Trace:
    """``trace`` from another start; the part before it follows at the end of the period."""
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


def seeded(spec: str, seed: int) -> str:
    """The synthetic walk ``spec`` with another seed, ``seed`` more; anything else as it is."""
    name, _, first = spec.partition(SEED)
    if not (seed and spec.startswith("synthetic") and (first.isdecimal() or not first)):
        return spec
    return f"{name}{SEED}{int(first or 0) + seed}"


def walk_of(spec: str, focus: Focus, window_us: int, seed: int) -> PoseTrace:
    """The walk named by ``spec``, or a variation: for a recorded walk, a later part of it.

    ``window_us`` is the length of the play. Raises :class:`TraceError`.
    """
    if not seed:
        return open_poses(spec, focus, window_us=window_us)
    if spec.startswith("synthetic"):
        return open_poses(seeded(spec, seed), focus)
    walk = read_poses(spec)
    start_us = round(share_of(seed) * max(walk.duration_us - window_us, 0))
    return place(walk.window(start_us, walk.duration_us), focus, window_us=window_us)
