"""Processes of the demo that do not get going."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from cags_bench.demo import processes
from cags_bench.demo.processes import Process
from cags_bench.demo.run import CLIENT_GRACE_S, client_limit_s, wait_for_client
from cags_common.errors import NetworkError


def started(program: str, log: Path) -> Process:
    with log.open("w") as stderr:
        handle = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, stderr=stderr, text=True)
    return Process("role", handle, log)


@pytest.mark.parametrize(
    ("program", "why"),
    [
        ("import time; time.sleep(60)", "said nothing for 0.2 s; try again when this machine has less to do"),
        ("import sys; sys.exit('no such scene')", "no such scene"),
        ("import os, sys, time; os.close(1); time.sleep(0.5); sys.exit('no such scene')", "no such scene"),
    ],
)
def test_why_a_process_did_not_start(program: str, why: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ended = "exit" in program
    monkeypatch.setattr(processes, "READY_TIMEOUT_S", 30.0 if ended else 0.2)
    process = started(program, tmp_path / "log")
    try:
        with pytest.raises(NetworkError, match=f"role did not start: .*{why}"):
            process.ready()
    finally:
        process.stop()


def test_a_process_that_goes_on_talking_after_its_ready_line_can_end(tmp_path: Path) -> None:
    """The live page's client once hung at its end with a pipe full of frames, and was killed ten seconds later."""
    process = started("print('{\"ready\": true}', flush=True); print('x' * 1_000_000)", tmp_path / "log")
    try:
        assert process.ready() == {"ready": True}
        assert process.handle.wait(20) == 0
    finally:
        process.stop()


def test_a_client_that_takes_too_long_is_named_in_one_line(tmp_path: Path) -> None:
    process = started("import time; time.sleep(60)", tmp_path / "log")
    try:
        with pytest.raises(NetworkError, match=r"role did not end within 0 s; give fewer --frames"):
            wait_for_client(process, 0.1)
    finally:
        process.stop()


def test_a_long_clip_has_the_time_that_it_lasts_beside_that_of_its_scores() -> None:
    assert client_limit_s(9000, 30.0) > CLIENT_GRACE_S + 9000 / 30.0 + client_limit_s(9000, 1e9) / 2
