"""A disk that is full, or that may only be read: serving goes on; who needs the disk says one line."""

from __future__ import annotations

import asyncio
import contextlib
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

import pytest

from support.siege import encode_small, frames_go_on, keep, watching

pytestmark = [pytest.mark.faults, pytest.mark.timeout(240)]

KINDS = ("full", "read-only")


@dataclass
class Disk:
    """A file system of its own."""

    path: Path
    kind: str

    def fail(self) -> None:
        """From now on nothing can be written."""
        if self.kind == "read-only":
            subprocess.run(["mount", "-o", "remount,ro", str(self.path)], check=True)
            return
        with (self.path / "ballast").open("wb", buffering=0) as ballast, contextlib.suppress(OSError):
            while True:
                ballast.write(bytes(4096))


@pytest.fixture(params=KINDS)
def disk(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Disk]:
    folder = tmp_path / "disk"
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", str(folder)]
    if subprocess.run(mount, capture_output=True, check=False).returncode != 0:
        pytest.skip("a file system can be mounted by root alone")
    try:
        yield Disk(folder, request.param)
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=True)


def test_a_server_that_cannot_write_what_it_remembers_serves_on(bundle: Path, tmp_path: Path, disk: Disk) -> None:
    written = {"--session-logs": str(disk.path / "s")}
    if disk.kind == "full":  # one with open files cannot be made read-only
        written["--event-traces"] = str(disk.path / "t")

    async def watch(url: str) -> None:
        async with watching(url, 2) as viewers:
            await asyncio.to_thread(disk.fail)
            async with watching(url, 2):  # who leaves: their session logs are to be written
                pass
            await frames_go_on(viewers)

    with keep(bundle, tmp_path, *chain(*written.items())) as server:
        asyncio.run(watch(server.url))
        assert server.stop() <= 5.0, "a second or so where the machine is its own"
        words = server.log.read_text()
    assert "Traceback" not in words
    assert all(folder in words for folder in written.values()), words
    assert len(words.splitlines()) <= 30, words


def says_one_line(module: str, *flags: str) -> None:
    done = subprocess.run(
        [sys.executable, "-m", module, *flags], capture_output=True, text=True, check=False, timeout=200
    )
    assert done.returncode == 1, done.stderr
    assert len(done.stderr.splitlines()) == 1, done.stderr


@pytest.mark.parametrize("output", [("--json", "report.jsonl"), ("--save", "clip.mp4"), ("--save", "pictures")])
def test_a_client_that_cannot_write_says_one_line(
    bundle: Path, tmp_path: Path, disk: Disk, output: tuple[str, str]
) -> None:
    disk.fail()
    with keep(bundle, tmp_path) as server:
        url = ("--url", server.url, "--width", "96", "--height", "72", "--restore", "none", "--headless")
        says_one_line("cags_client", *url, output[0], str(disk.path / output[1]))


def test_an_encoder_that_cannot_write_says_one_line(disk: Disk) -> None:
    disk.fail()
    says_one_line("cags_encoder", "procedural:size=300,frames=2", str(disk.path / "clip.cags"), "--train-splats", "256")


def test_the_small_encoder_does_write_elsewhere(tmp_path: Path) -> None:
    assert encode_small(tmp_path, "procedural:size=300,frames=2").is_dir()
