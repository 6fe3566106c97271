"""A progress bar on stderr."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

Tell = Callable[[str, int, int], None]
"""Called with the stage's name, steps done and steps in all."""

_TITLES = {
    "prune": "pruning",
    "sample": "looking at frames",
    "codebooks": "training codebooks",
    "order": "measuring levels",
    "encode": "encoding frames",
    "verify": "verifying frames",
}


@contextmanager
def progress_bar() -> Iterator[Tell]:
    """Yield the callback that :func:`~cags_encoder.pipeline.encode` takes; one bar a stage, gone when all is done."""
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
    console = Console(stderr=True)
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bars:
        tasks = {}

        def tell(stage: str, done: int, total: int) -> None:
            if stage not in tasks:
                tasks[stage] = bars.add_task(_TITLES.get(stage, stage), total=total)
            bars.update(tasks[stage], completed=done, total=total)

        yield tell
