"""Background tasks that nobody awaits: none of them ends unnoticed."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from functools import partial
from typing import Any


def watched(work: Coroutine[Any, Any, None], on_fault: Callable[[BaseException], None]) -> asyncio.Task[None]:
    """A task for ``work``. What it raises is told to ``on_fault`` at once, not when somebody asks the task.

    Keep the task: the event loop alone does not.
    """
    task = asyncio.create_task(work)
    task.add_done_callback(partial(_tell, on_fault))
    return task


def _tell(on_fault: Callable[[BaseException], None], task: asyncio.Task[None]) -> None:
    error = None if task.cancelled() else task.exception()
    if error is not None:
        on_fault(error)
