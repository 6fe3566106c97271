"""The same session again, and with other numbers of threads: virtual time must give the same bytes."""

from __future__ import annotations

import hashlib
from dataclasses import replace

from cags_bench.jsonl import check, dump
from cags_bench.reproduce.plan import Context
from cags_bench.reproduce.section import Cell, Section

FRAMES = 12
"""Enough for tiles, references and their losses; the session runs three times and is never taken from the cache."""

THREADS = (1, 2, 2)


def determinism(context: Context) -> Section:
    """Digests of all that a session leaves behind: every frame's record, the summary, and a picture."""
    plan = context.plan
    case = replace(context.case(plan.scenes[0], "cags", plan.rates_mbps[0]), frames=min(plan.frames, FRAMES))
    rows: list[list[Cell]] = []
    for run, threads in enumerate(THREADS, start=1):
        context.tell(f"determinism, run {run} of {len(THREADS)}, {threads} threads")
        result = case.compute(replace(context.runner, threads=threads))
        del result["spent"]  # processor times
        rows.append([f"run {run}", threads, hashlib.sha256(dump(result).encode()).hexdigest()[:32]])
    same = len({row[2] for row in rows}) == 1
    return Section(
        name="determinism",
        title="The same bytes every time",
        paper="Not in the paper: two runs, and one with another number of threads, byte for byte.",
        columns=("session", "threads", "digest of all results"),
        rows=rows,
        checks=[check("virtual time, two runs and 1 or 2 threads", "one digest", len({r[2] for r in rows}), same)],
    )
