"""A killed ``cags-encode`` goes on where it was, to the bytes of a run that nobody killed."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

from cags_encoder.execution.journal import Journal
from support.bundle_bytes import assert_same_bundle
from support.processes import assert_one_clear_line, run_module

SCENE = "procedural:size=3000,frames=30"
FLAGS = ("--train-splats", "4000", "--lod-order", "paper")


def encode(out: Path, *more: str) -> subprocess.CompletedProcess[str]:
    done = run_module("cags_encoder", SCENE, str(out), *FLAGS, *more)
    assert done.returncode == 0, done.stderr
    return done


def killed_midway(out: Path, frames: int, *more: str) -> Path:
    """Start encoding and SIGKILL the whole process group once ``frames`` are finished; the folder of its records."""
    records = out.parent / f".{out.name}.encoding"
    command = [sys.executable, "-m", "cags_encoder", SCENE, str(out), *FLAGS, *more]
    running = subprocess.Popen(command, start_new_session=True, stderr=subprocess.DEVNULL)
    deadline = time.monotonic() + 120
    try:
        while len(list(records.glob("*.npz"))) < frames:
            assert running.poll() is None, "it was done before it could be killed"
            assert time.monotonic() < deadline
            time.sleep(0.005)
    finally:
        os.killpg(running.pid, signal.SIGKILL)
        running.wait()
    assert not out.exists()
    return records


def test_a_killed_run_goes_on_to_the_same_bytes(tmp_path: Path) -> None:
    encode(tmp_path / "whole", "--workers", "1")
    records = killed_midway(tmp_path / "out", 8, "--workers", "2")
    before = {p.name: p.stat().st_mtime_ns for p in records.glob("*.npz")}
    assert 8 <= len(before) < 30
    last = records / sorted(before)[-1]
    last.write_bytes(last.read_bytes()[:-100])  # as a full disk or a crash of the machine may leave it
    again = killed_midway(tmp_path / "out", len(before) + 4, "--workers", "1")
    kept = {p.name: p.stat().st_mtime_ns for p in again.glob("*.npz")}
    assert all(kept[name] == before[name] for name in sorted(before)[:-1]), "finished frames are not encoded again"
    encode(tmp_path / "out", "--workers", "2")
    assert_same_bundle(tmp_path / "out", tmp_path / "whole")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["out", "whole"], "nothing is left behind"


def test_two_runs_of_one_bundle_do_not_mix(tmp_path: Path) -> None:
    with Journal(tmp_path / ".out.encoding", "another run"):
        second = run_module("cags_encoder", "procedural:size=500,frames=1", str(tmp_path / "out"), "--workers", "1")
    assert_one_clear_line(second, ".out.encoding", "another process encodes this bundle", code=1)
