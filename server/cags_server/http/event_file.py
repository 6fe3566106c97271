"""The event trace of one session as a file: every step of sending, a JSON line each, for ``cags-bench network --plot``.

Written as it happens, unlike the session log, which remembers frames and is written at the end.
"""

from __future__ import annotations

import json
import logging
from pathlib import Path
from typing import TextIO

from cags_protocol.sessions.tracing import EventTrace, Record

MAX_BYTES = 64 * 1024 * 1024
"""A trace ends there: a line a packet of 8 KiB comes to that after about two gigabytes of stream."""

log = logging.getLogger(__name__)


class EventFile:
    """``RUN-NAME.events.jsonl`` in ``folder``; made with the first queued message, so not for who is refused."""

    def __init__(self, folder: Path, run: str, name: str) -> None:
        """``run``: the process, by :func:`~cags_server.records.run_name`; ``name``: the session."""
        self.path = folder / f"{run}-{name}.events.jsonl"
        self._file: TextIO | None = None
        self._left = MAX_BYTES
        self._header: Record = {}
        self._told = False
        self.trace = EventTrace(self._take, name)
        """What the session is given."""

    def close(self) -> None:
        """The session is over. What is buffered is written now, so a full disk may be met here."""
        self._left, file, self._file = 0, self._file, None
        if file is not None:
            try:
                file.close()
            except OSError as error:
                self._cannot_write(error)

    def _take(self, record: Record) -> None:
        if not self._header:
            self._header = record
        elif self._left > 0 and (self._file is not None or record["event"] == "queued"):
            try:
                self._write(record)
            except OSError as error:
                self._cannot_write(error)

    def _cannot_write(self, error: OSError) -> None:
        """End the trace, with one line: a full disk is no reason to end a stream."""
        self._left = 0
        if not self._told:
            self._told = True
            log.warning("%s: cannot be written (%s); the trace ends here", self.path, error.strerror)

    def _write(self, record: Record) -> None:
        if self._file is None:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._file = self.path.open("w", encoding="utf-8")
            self._file.write(json.dumps(self._header) + "\n")
        self._left -= self._file.write(json.dumps(record) + "\n")
