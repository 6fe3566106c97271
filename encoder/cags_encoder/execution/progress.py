"""Progress on stderr: a bar in a terminal, occasional lines in a pipe or log."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TextIO

Tell = Callable[[str, int, int], None]
"""Called with the stage's name, completed steps and total steps."""

LINE_EVERY_S = 5.0
"""Seconds between two lines if stderr is not a terminal; shorter runs print nothing."""

LOOK_EVERY_S = 0.5
"""Seconds between two looks whether a stage has gone on for so long without a step."""

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
        if lines:
            with _told_meanwhile(ProgressLines(sys.stderr, time.monotonic)) as written:
                yield written.tell
        else:
            yield _silent
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


class ProgressLines:
    """Writes a line to ``stream`` every :data:`LINE_EVERY_S` seconds of ``clock``, also while a step takes longer: the
    training of codebooks is one step, of up to a minute.
    """

    def __init__(self, stream: TextIO, clock: Callable[[], float]) -> None:
        self._stream, self._clock = stream, clock
        self._last_s = self._told_s = clock()  # of the last line, and of the last step
        self._stage, self._done, self._total = "", 0, 0
        self._lock = threading.Lock()

    def tell(self, stage: str, done: int, total: int) -> None:
        """A :data:`Tell`."""
        with self._lock:
            self._stage, self._done, self._total, self._told_s = stage, done, total, self._clock()
            if self._is_due():
                self._write(f"{done} of {total}")

    def look(self) -> None:
        """Tell of a step that takes long."""
        with self._lock:
            lasts_s = self._clock() - self._told_s
            if self._done < self._total and lasts_s >= LINE_EVERY_S and self._is_due():
                self._write(f"{self._done} of {self._total}, for {lasts_s:.0f} s")

    def _is_due(self) -> bool:
        return self._clock() - self._last_s >= LINE_EVERY_S

    def _write(self, text: str) -> None:
        self._last_s = self._clock()
        print(f"{_TITLES.get(self._stage, self._stage)}: {text}", file=self._stream, flush=True)


@contextmanager
def _told_meanwhile(written: ProgressLines) -> Iterator[ProgressLines]:
    """Look again and again from a thread of its own."""
    ended = threading.Event()

    def watch() -> None:
        while not ended.wait(LOOK_EVERY_S):
            written.look()

    thread = threading.Thread(target=watch, name="progress", daemon=True)
    thread.start()
    try:
        yield written
    finally:
        ended.set()
        thread.join()
