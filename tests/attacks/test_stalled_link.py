"""A link that stalls without a reset: the client goes on drawing, heeds signals, and comes back."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from support.siege import keep
from support.stalling import relay

SIZE = ("--width", "96", "--height", "72", "--restore", "none")


@contextmanager
def client(port: int, report: Path, *flags: str) -> Iterator[subprocess.Popen[str]]:
    url = f"ws://127.0.0.1:{port}/stream"
    command = [sys.executable, "-m", "cags_client", "--url", url, *SIZE, "--json", str(report), *flags]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        try:
            yield process
        finally:
            process.kill()


def wait_for(server_log: Path, word: str, times: int = 1) -> None:
    deadline = time.monotonic() + 30
    while server_log.read_text().count(word) < times:
        assert time.monotonic() < deadline
        time.sleep(0.05)


@pytest.mark.siege
def test_signals_are_heeded_on_a_stalled_link(bundle: Path, tmp_path: Path) -> None:
    """Two clients beside each other: one is told to end by each signal."""
    numbers = (signal.SIGTERM, signal.SIGINT)
    with ExitStack() as stack:
        server = stack.enter_context(keep(bundle, tmp_path))
        links = [stack.enter_context(relay(server.port)) for _ in numbers]
        flags = ("--pose-rate", "1000", "--start-delay-ms", "8000")  # many poses: a link is full within a second
        reports = [tmp_path / f"{number.name}.jsonl" for number in numbers]
        clients = [
            stack.enter_context(client(link.port, report, *flags)) for link, report in zip(links, reports, strict=True)
        ]
        wait_for(server.log, "joined", len(numbers))
        time.sleep(2.0)
        for link in links:
            link.stall()
        time.sleep(3.0)
        for number, process in zip(numbers, clients, strict=True):
            begun = time.monotonic()
            process.send_signal(number)
            _, words = process.communicate(timeout=30)
            took_s = time.monotonic() - begun
            assert took_s <= 1.5, "within a second, and some time for the interpreter to end"
            assert process.returncode == 128 + number, words


@pytest.mark.faults
def test_the_picture_goes_on_while_the_link_is_stalled(bundle: Path, tmp_path: Path) -> None:
    report = tmp_path / "report.jsonl"
    with (
        keep(bundle, tmp_path) as server,
        relay(server.port) as link,
        client(link.port, report, "--pose-rate", "1000", "--start-delay-ms", "4000") as process,
    ):
        wait_for(server.log, "joined")
        time.sleep(2.5)
        link.stall()
        _, words = process.communicate(timeout=30)
    assert process.returncode == 0, words
    frames = [json.loads(line) for line in report.read_text().splitlines()][:-1]
    assert [each["frame"] for each in frames][-1] == 19, "the clip is drawn to its end"
