"""An event trace as a file: only of sessions that send, bounded, and harmless where it cannot be written."""

from __future__ import annotations

import json
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
