"""A table in the terminal that is drawn anew a few times a second, for commands that people watch."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

REFRESHES_PER_SECOND = 4.0


def watched(*, headless: bool) -> bool:
    """Whether somebody looks: stderr is a terminal, and nobody asked for quiet."""
    return not headless and sys.stderr.isatty()


@contextmanager
def live_table(draw: Callable[[], Table], console: Console | None = None) -> Iterator[None]:
    """Show what ``draw`` makes, on stderr, until the context ends; the last one stays.

    ``draw`` is called in a thread of its own: it must only read. What is printed meanwhile goes above.
    """
    from rich.console import Console
    from rich.live import Live

    shown = console or Console(stderr=True, highlight=False)
    with Live(console=shown, get_renderable=draw, refresh_per_second=REFRESHES_PER_SECOND):
        yield
