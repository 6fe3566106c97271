"""Pools of processes: one library thread each, and no worker outlives the process that started it."""

import os
import signal
import subprocess
import sys
import time
from concurrent.futures.process import BrokenProcessPool
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


AT_WORK = """
import sys, time
from cags_common.cli import run_command
from cags_common.runtime.processes import process_pool
def body(argv):
    with process_pool(2, sys.argv[1]) as pool:
        futures = [pool.submit(time.sleep, 0.02) for _ in range(10_000)]
        print("up", flush=True)
        for future in futures:
            future.result()
if __name__ == "__main__":
    run_command("cags-try", body)
"""


@pytest.mark.parametrize("after_s", [0.0, 0.1, 1.0])
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("start", ["spawn", "forkserver"])
def test_a_signal_to_all_is_answered_by_the_parent(start: str, number: signal.Signals, after_s: float) -> None:
    """As Ctrl-C in a terminal and ``timeout`` send it. Workers ended in tracebacks, or left their parent waiting."""
    with subprocess.Popen(
        [sys.executable, "-c", f"import signal; signal.signal(2, signal.default_int_handler)\n{AT_WORK}", start],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as parent:
        assert parent.stdout is not None
        assert parent.stdout.readline() == "up\n"
        time.sleep(after_s)
        os.killpg(parent.pid, number)
        _, said = parent.communicate(timeout=20)  # workers, too, have let go of its output
    assert parent.returncode == 128 + number
    assert said == ("cags-try: interrupted\n" if number == signal.SIGINT else "")


def test_a_worker_that_is_asked_to_end_ends() -> None:
    with process_pool(1) as pool:
        os.kill(pool.submit(os.getpid).result(), signal.SIGTERM)
        with pytest.raises(BrokenProcessPool):
            pool.submit(time.sleep, 60).result(timeout=30)


def test_libraries_take_one_thread_in_workers_and_what_they_took_outside(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.delenv("MKL_NUM_THREADS", raising=False)
    with process_pool(1) as pool:
        assert [pool.submit(os.getenv, name).result() for name in LIBRARY_THREADS] == ["1"] * len(LIBRARY_THREADS)
    assert os.environ["OMP_NUM_THREADS"] == "7"
    assert "MKL_NUM_THREADS" not in os.environ
