"""An event trace as a file: only of sessions that send, bounded, and harmless where it cannot be written."""

from __future__ import annotations

import errno
import json
from io import StringIO
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from cags_server.http import event_file
from cags_server.http.event_file import EventFile

TILE: Any = SimpleNamespace(message=SimpleNamespace(TAG="tile", frame=3), payload=b"1234")


def lines(file: EventFile) -> list[dict[str, Any]]:
    return [json.loads(line) for line in file.path.read_text().splitlines()]


def test_it_begins_with_the_first_message_and_has_the_header_first(tmp_path: Path) -> None:
    file = EventFile(tmp_path / "traces", "run", "s1")
    file.trace.closed(1)
    assert not file.path.exists(), "nothing was queued: a refused client leaves no file"
    file.trace.queued(2, TILE, 4)
    file.trace.delivered(3, TILE)
    file.close()
    header, queued, delivered = lines(file)
    assert header["session"] == "s1"
    assert (queued["event"], queued["frame"], queued["bytes"]) == ("queued", 3, 4)
    assert delivered["event"] == "delivered"


def test_it_ends_at_its_bound_and_after_its_close(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(event_file, "MAX_BYTES", 150)
    file = EventFile(tmp_path, "run", "s2")
    for number in range(100):
        file.trace.queued(number, TILE, 4)
    file.close()
    file.trace.closed(100)
    assert 1 < len(lines(file)) < 5


def test_a_disk_that_cannot_be_written_ends_the_trace_with_one_line(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "taken").write_text("a file, not a folder")
    file = EventFile(tmp_path / "taken", "run", "s3")
    file.trace.queued(1, TILE, 4)
    file.trace.queued(2, TILE, 8)
    assert [record.levelname for record in caplog.records] == ["WARNING"]
    assert "the trace ends here" in caplog.text


class FullDisk(StringIO):
    """Takes what it is given, and cannot write it out in the end; or no more from the start."""

    def __init__(self, *, at_once: bool) -> None:
        super().__init__()
        self._at_once = at_once

    def write(self, text: str) -> int:
        if self._at_once:
            raise OSError(errno.ENOSPC, "No space left on device")
        return super().write(text)

    def close(self) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")


@pytest.mark.parametrize("at_once", [False, True])
def test_a_disk_that_is_full_at_the_close_is_one_line_and_no_error(
    at_once: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """What is buffered is written by the close: its error used to leave the handler of the whole session."""
    disk = FullDisk(at_once=at_once)
    file = EventFile(tmp_path, "run", "s4")
    with monkeypatch.context() as patched:
        patched.setattr(Path, "open", lambda *_, **__: disk)
        file.trace.queued(1, TILE, 4)
    file.close()
    file.close()
    assert [record.levelname for record in caplog.records] == ["WARNING"]
    assert "cannot be written (No space left on device); the trace ends here" in caplog.text
