"""A server that lies, floods, stalls or speaks nonsense: the client says one line or plays on, in bounded memory."""

from __future__ import annotations

import contextlib
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from support.hostile_server import ALL, hostile_server
from support.siege import Keep, keep

pytestmark = pytest.mark.faults

MOST_MB = 450.0
"""Resident memory at its largest: 200 MB of libraries, 150 of the server's making, and some for the machine."""

MOST_S = 120.0


@dataclass
class Watched:
    """What came of a client's run."""

    code: int
    words: str
    seconds: float
    peak_mb: float


def watch(url: str, *flags: str, interrupt: Callable[[], object] | None = None) -> Watched:
    """A client at ``url``; ``interrupt``: SIGTERM two seconds after this is so, from when on seconds are counted."""
    command = [sys.executable, "-m", "cags_client", "--url", url, "--width", "96", "--height", "72", "--json", "-"]
    command += ["--join-timeout", "3", "--reconnect-s", "3", *flags]
    began = time.monotonic()
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as process:
        try:
            if interrupt is not None:
                while not interrupt():
                    assert time.monotonic() - began < MOST_S
                    time.sleep(0.05)
                time.sleep(2.0)
                assert process.poll() is None, "it has ended by itself"
                process.send_signal(signal.SIGTERM)
                began = time.monotonic()
            peak_mb = 0.0
            while process.poll() is None:
                peak_mb = max(peak_mb, peak_of(process.pid))
                assert time.monotonic() - began < MOST_S, f"it does not end, at {peak_mb:.0f} MB"
                time.sleep(0.05)
            assert process.stderr is not None
            return Watched(process.returncode, process.stderr.read(), time.monotonic() - began, peak_mb)
        finally:
            process.kill()


def peak_of(pid: int) -> float:
    """Largest resident memory so far, MB; 0 once it has ended."""
    with contextlib.suppress(OSError):
        for line in Path(f"/proc/{pid}/status").read_text().splitlines():
            if line.startswith("VmHWM"):
                return int(line.split()[1]) * 1024 / 1e6
    return 0.0


@pytest.fixture(scope="module")
def server(bundle: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Keep]:
    with keep(bundle, tmp_path_factory.mktemp("server")) as running:
        yield running


ENDS = {
    "malformed": "malformed",
    "silent": "no first frame within 3 s",
    "mute": "no first frame within 3 s",
    "hang-up": "no first frame within 3 s",
    "capacity": "--max-memory-mb",
    "deep-manifest": "is not JSON",
    "no-manifest": "takes longer than",
}
"""What the client ends with a line about; in the face of the others it plays on to the end of the clip."""


@pytest.mark.timeout(200)
@pytest.mark.parametrize("trick", ALL)
def test_a_client_survives_a_server_that_means_ill(server: Keep, trick: str) -> None:
    with hostile_server(server.port, trick) as hostile:
        outcome = watch(f"ws://127.0.0.1:{hostile.port}/stream")
    assert outcome.code == (1 if trick in ENDS else 0), outcome
    assert len(outcome.words.splitlines()) == outcome.code, outcome
    assert ENDS.get(trick, "") in outcome.words
    assert outcome.peak_mb <= MOST_MB, outcome
    assert hostile.sessions <= 12, "it does not storm a server that hangs up"
    assert server.process.poll() is None


@pytest.mark.timeout(200)
def test_a_client_in_a_flood_heeds_sigterm(server: Keep) -> None:
    with hostile_server(server.port, "endless-ends") as hostile:
        outcome = watch(
            f"ws://127.0.0.1:{hostile.port}/stream", "--start-delay-ms", "10000", interrupt=lambda: hostile.sessions
        )
    assert outcome.code == 128 + signal.SIGTERM, outcome
    assert outcome.seconds <= 3.0, "within a second where the machine is its own"
    assert outcome.peak_mb <= MOST_MB, outcome
