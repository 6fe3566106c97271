"""Pools of processes: one library thread each, and no worker outlives the process that started it."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from cags_common.runtime.processes import LIBRARY_THREADS, process_pool

PARENT = """
import os, sys, time
from cags_common.runtime.processes import process_pool
with process_pool(1, sys.argv[1]) as pool:
    print(pool.submit(os.getpid).result(), flush=True)
    time.sleep(60)
"""


def running(pid: int) -> bool:
    status = Path(f"/proc/{pid}/stat")
    try:
        return status.read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="processes are looked up in /proc")
@pytest.mark.parametrize("start", ["spawn", "forkserver"])
def test_workers_end_when_their_parent_is_killed(start: str) -> None:
    with subprocess.Popen([sys.executable, "-c", PARENT, start], stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        worker = int(parent.stdout.readline())
        assert running(worker)
        parent.send_signal(signal.SIGKILL)
    deadline = time.monotonic() + 30
    while running(worker):
        assert time.monotonic() < deadline, "the worker outlived its parent"
        time.sleep(0.02)


def test_libraries_take_one_thread_in_workers_and_what_they_took_outside(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.delenv("MKL_NUM_THREADS", raising=False)
    with process_pool(1) as pool:
        assert [pool.submit(os.getenv, name).result() for name in LIBRARY_THREADS] == ["1"] * len(LIBRARY_THREADS)
    assert os.environ["OMP_NUM_THREADS"] == "7"
    assert "MKL_NUM_THREADS" not in os.environ
