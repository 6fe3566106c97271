"""Encoding on a dask cluster of real processes, one worker killed midway: the bytes of a run in one process."""

import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from support.bundle_bytes import assert_same_bundle
from support.processes import assert_one_clear_line, free_port, run_module

SCENE = "procedural:size=4000,frames=40"
FLAGS = ("--train-splats", "4000", "--lod-order", "paper")


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[tuple[str, list[subprocess.Popen[bytes]]]]:
    """A scheduler's address and its two workers, as dask's own commands start them."""
    pytest.importorskip("distributed", reason="the cluster: pip install 'cags-stream[scale]'")
    address, work = f"tcp://127.0.0.1:{free_port()}", tmp_path / "dask"
    work.mkdir()
    dask = [sys.executable, "-m", "dask"]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "cwd": work}
    commands = [[*dask, "scheduler", "--host", address.rpartition(":")[0], "--port", address.rpartition(":")[2],
                 "--no-dashboard"]]  # fmt: skip
    commands += [
        [*dask, "worker", address, "--nthreads", "1", "--no-dashboard", "--no-nanny", "--local-directory", str(work)]
    ] * 2
    running = [subprocess.Popen(command, **quiet) for command in commands]  # type: ignore[call-overload]
    try:
        wait_for_workers(address, 2)
        yield address, running[1:]
    finally:
        for process in running:
            process.kill()
            process.wait()


def wait_for_workers(address: str, count: int) -> None:
    script = f"from distributed import Client; Client({address!r}, timeout='60s').wait_for_workers({count}, timeout=60)"
    subprocess.run([sys.executable, "-c", script], check=True, timeout=120, capture_output=True)


@pytest.mark.slow
def test_a_killed_worker_changes_nothing(cluster: tuple[str, list[subprocess.Popen[bytes]]], tmp_path: Path) -> None:
    address, workers = cluster
    whole = run_module("cags_encoder", SCENE, str(tmp_path / "whole"), *FLAGS, "--workers", "1")
    assert whole.returncode == 0, whole.stderr
    command = [sys.executable, "-m", "cags_encoder", SCENE, str(tmp_path / "out"), *FLAGS, "--scheduler", address]
    running = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 120
    while len(list((tmp_path / ".out.encoding").glob("*.npz"))) < 5:
        assert running.poll() is None, "it was done before a worker could be killed"
        assert time.monotonic() < deadline
        time.sleep(0.005)
    workers[0].kill()
    errors = running.communicate(timeout=200)[1]
    assert running.returncode == 0, errors
    assert_same_bundle(tmp_path / "out", tmp_path / "whole")


def test_a_scheduler_that_is_not_there_is_named(tmp_path: Path) -> None:
    pytest.importorskip("distributed", reason="the cluster: pip install 'cags-stream[scale]'")
    address = f"tcp://127.0.0.1:{free_port()}"
    done = run_module("cags_encoder", "procedural:size=500,frames=1", str(tmp_path / "out"), "--scheduler", address)
    assert_one_clear_line(done, address, "cannot be reached", code=1)
