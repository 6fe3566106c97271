"""Server, shaper and client as operating-system processes that end with the demo."""

from __future__ import annotations

import contextlib
import json
import queue
import subprocess
import sys
import threading
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import IO, Any

from cags_common.errors import NetworkError

READY_TIMEOUT_S = 60.0
STOP_TIMEOUT_S = 10.0


@dataclass
class Process:
    """A running command: its name, handle, and the file of its stderr."""

    name: str
    handle: subprocess.Popen[str]
    log: Path

    def ready(self) -> dict[str, Any]:
        """The process's ready line; what it prints after that is discarded.

        Raises :class:`NetworkError` if it ends or stays silent instead.
        """
        line = _first_line(self.handle.stdout, READY_TIMEOUT_S)
        try:
            message = json.loads(line or "")
        except json.JSONDecodeError:
            message = {}
        if not message.get("ready"):
            raise NetworkError(f"{self.name} did not start: {self._why_silent(ended=line == '')}")
        return dict(message)

    def _why_silent(self, *, ended: bool) -> str:
        if ended:  # its output has ended, and so will it, in a moment
            with contextlib.suppress(subprocess.TimeoutExpired):
                self.handle.wait(STOP_TIMEOUT_S)
        elif self.handle.poll() is None:
            return f"it said nothing for {READY_TIMEOUT_S:g} s; try again when this machine has less to do"
        return self.last_words()

    def last_words(self) -> str:
        """The last line that the process wrote to its log."""
        lines = self.log.read_text(encoding="utf-8", errors="replace").strip().splitlines()
        return lines[-1] if lines else f"no message; its log is {self.log}"

    def stop(self) -> None:
        """Terminate the process, and kill it if it does not end."""
        if self.handle.poll() is None:
            self.handle.terminate()
            try:
                self.handle.wait(STOP_TIMEOUT_S)
            except subprocess.TimeoutExpired:
                self.handle.kill()
                self.handle.wait()
        if self.handle.stdout:
            self.handle.stdout.close()


@dataclass
class ProcessGroup:
    """A context that stops all processes started in it, last first."""

    logs: Path
    _running: list[Process] = field(default_factory=list)

    def __enter__(self) -> ProcessGroup:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for process in reversed(self._running):
            with contextlib.suppress(OSError):
                process.stop()

    def start(self, module: str, arguments: Sequence[str]) -> Process:
        """Start ``python -m module arguments``; its stderr goes to ``logs/module.log`` (``module-2.log``, ..)."""
        number = 1 + sum(process.name == module for process in self._running)
        log = self.logs / (f"{module}.log" if number == 1 else f"{module}-{number}.log")
        with log.open("w", encoding="utf-8") as stderr:
            handle = subprocess.Popen(
                [sys.executable, "-m", module, *arguments],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=stderr,
                text=True,
            )
        process = Process(module, handle, log)
        self._running.append(process)
        return process


def _first_line(stream: IO[str] | None, timeout_s: float) -> str | None:
    """The first line of a pipe: empty at its end, None if nothing comes in time. The others are read too, until it
    ends: a process blocks at a pipe that is full.
    """
    assert stream is not None
    lines: queue.Queue[str] = queue.Queue()

    def read() -> None:
        with contextlib.suppress(ValueError):  # closed meanwhile
            lines.put(stream.readline())
            for _ in stream:
                pass

    threading.Thread(target=read, daemon=True).start()
    try:
        return lines.get(timeout=timeout_s)
    except queue.Empty:
        return None
