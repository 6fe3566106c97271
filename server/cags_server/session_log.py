"""One JSON-lines file a session: every planned frame, for reports."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

from cags_common.files import whole_file, writable_folder
from cags_protocol.events import Closed
from cags_server.records import StreamStats

FORMAT = "cags-session"


def write_session(folder: Path, name: str, stats: StreamStats, ending: Closed | None) -> Path:
    """Write what is remembered of a session; the first line describes the file, the last the session's end.

    Raises :class:`OutputError` where it cannot be written.
    """
    path = writable_folder(folder) / f"{name}.jsonl"
    with whole_file(path) as writing, writing.open("w", encoding="utf-8") as file:
        head = {
            "format": FORMAT,
            "version": 1,
            "session": name,
            "clocks": {"planned_us": "server", "display_us": "client"},
        }
        print(json.dumps(head), file=file)
        for record in stats.records:
            print(json.dumps(asdict(record)), file=file)
        end = {name: value for name, value in vars(stats).items() if name != "records"}
        end["ending"] = None if ending is None else {"code": ending.code, "reason": ending.reason}
        print(json.dumps(end), file=file)
    return path
