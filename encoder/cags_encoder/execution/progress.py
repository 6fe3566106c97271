"""Progress on stderr: a bar in a terminal, occasional lines in a pipe or log."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TextIO

Tell = Callable[[str, int, int], None]
"""Called with the stage's name, completed steps and total steps."""

LINE_EVERY_S = 5.0
"""Seconds between two lines if stderr is not a terminal; shorter runs print nothing."""

_TITLES = {
    "prune": "pruning",
    "sample": "sampling frames",
    "codebooks": "training codebooks",
    "order": "measuring levels",
    "encode": "encoding frames",
    "verify": "verifying frames",
}


@contextmanager
def progress_bar(*, lines: bool = False) -> Iterator[Tell]:
    """Yield the callback that :func:`~cags_encoder.pipeline.encode` takes; one bar per stage, removed at the end.

    If stderr is not a terminal, nothing is shown, or occasional lines if ``lines``.
    """
    if not sys.stderr.isatty():
        yield progress_lines(sys.stderr, time.monotonic) if lines else _silent
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    console = Console(stderr=True)
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bars:
        tasks = {}

        def tell(stage: str, done: int, total: int) -> None:
            if stage not in tasks:
                tasks[stage] = bars.add_task(_TITLES.get(stage, stage), total=total)
            bars.update(tasks[stage], completed=done, total=total)

        yield tell


def _silent(stage: str, done: int, total: int) -> None:
    """Show nothing."""


def progress_lines(stream: TextIO, clock: Callable[[], float]) -> Tell:
    """A callback that writes a line to ``stream`` every :data:`LINE_EVERY_S` seconds of ``clock``."""
    last_s = clock()

    def tell(stage: str, done: int, total: int) -> None:
        nonlocal last_s
        if clock() - last_s >= LINE_EVERY_S:
            last_s = clock()
            print(f"{_TITLES.get(stage, stage)}: {done} of {total}", file=stream, flush=True)

    return tell
