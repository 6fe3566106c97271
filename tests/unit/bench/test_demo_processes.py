"""Processes of the demo that do not get going."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from cags_bench.demo import processes
from cags_bench.demo.processes import Process
from cags_common.errors import NetworkError


@pytest.mark.parametrize(
    ("program", "why"),
    [
        ("import time; time.sleep(60)", "said nothing for 0.2 s; try again when this machine has less to do"),
        ("import sys; sys.stdout.close(); sys.exit('no such scene')", "no such scene"),
    ],
)
def test_why_a_process_did_not_start(program: str, why: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ended = "exit" in program
    monkeypatch.setattr(processes, "READY_TIMEOUT_S", 30.0 if ended else 0.2)
    log = tmp_path / "log"
    with log.open("w") as stderr:
        handle = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, stderr=stderr, text=True)
    if ended:
        handle.wait()
    process = Process("role", handle, log)
    try:
        with pytest.raises(NetworkError, match=f"role did not start: .*{why}"):
            process.ready()
    finally:
        process.stop()
