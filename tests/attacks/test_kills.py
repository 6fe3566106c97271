"""kill -9 of each role, in every order: who is left says a line, serves on, or comes back."""

from __future__ import annotations

import itertools
import json
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from support.siege import MORE_FRAMES, Keep, Viewer, frames_go_on, keep, until, watching

ROLES = ("client", "shaper", "server")


@contextmanager
def process(module: str, *flags: str, **named: object) -> Iterator[subprocess.Popen[str]]:
    command = [sys.executable, "-m", module, *flags]
    with subprocess.Popen(command, text=True, **named) as started:  # type: ignore[call-overload]
        try:
            yield started
        finally:
            started.kill()


class Stage:
    """Server, shaper and a client through it; two viewers who go to the server themselves."""

    def __init__(self, stack: ExitStack, server: Keep, bundle: Path, folder: Path) -> None:
        self._stack, self._bundle, self._folder, self.server = stack, bundle, folder, server
        self._before = self._joins()
        flags = ("--listen", "127.0.0.1:0", "--to", f"127.0.0.1:{self.server.port}", "--json")
        self.shaper = stack.enter_context(process("cags_shaper", *flags, stdout=subprocess.PIPE))
        assert self.shaper.stdout is not None
        self.url = f"ws://127.0.0.1:{json.loads(self.shaper.stdout.readline())['port']}/stream"
        watch = ("--url", self.url, "--width", "96", "--height", "72", "--reconnect-s", "1", "--json", "-")
        held = ("--start-delay-ms", "10000", "--restore", "none")  # it waits, joined
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE}
        self.client = stack.enter_context(process("cags_client", *watch, *held, **quiet))
        self.alive = set(ROLES)

    def joined(self) -> bool:
        """Whether the client has been let in."""
        return self._joins() > self._before

    def _joins(self) -> int:
        return self.server.log.read_text().count("joined")

    async def kill(self, role: str, viewers: Sequence[Viewer]) -> None:
        """Kill one, and look at who is left."""
        link_ends = role in ("client", "shaper") and {"client", "shaper"} <= self.alive
        {"client": self.client, "shaper": self.shaper, "server": self.server.process}[role].kill()
        self.alive.discard(role)
        if link_ends and "server" in self.alive:
            await until(
                lambda: any("left (" in line for line in self.server.log_lines), "the server holds on to the gone"
            )
        if "server" in self.alive:
            await frames_go_on(viewers)
            assert "Traceback" not in self.server.log.read_text()
        if role != "client" and "client" in self.alive:
            await self._client_says_why()
            self.alive.discard("client")
        if role == "server" and "shaper" in self.alive:
            await self._shaper_serves_the_next_server()

    async def _client_says_why(self) -> None:
        await until(lambda: self.client.poll() is not None, "the client does not end")
        assert self.client.stderr is not None
        words = self.client.stderr.read()
        assert self.client.returncode == 1, words
        assert len(words.splitlines()) == 1, words

    async def _shaper_serves_the_next_server(self) -> None:
        assert self.shaper.poll() is None
        again = self._folder / "again"
        again.mkdir()
        self._stack.enter_context(keep(self._bundle, again, "--port", str(self.server.port)))
        async with watching(self.url, 1):
            pass


async def kill_in(order: Sequence[str], bundle: Path, folder: Path) -> None:
    with ExitStack() as stack:
        server = stack.enter_context(keep(bundle, folder))
        async with watching(server.url, 2) as viewers:
            descriptors = server.descriptors
            stage = Stage(stack, server, bundle, folder)
            await until(stage.joined, "the client does not join")
            for role in order:
                await stage.kill(role, viewers)
                if stage.alive == {"server"}:
                    await until(lambda: server.descriptors <= descriptors + 1, "descriptors are kept")


@pytest.mark.faults
@pytest.mark.timeout(240)
async def test_client_shaper_and_server_are_killed_one_after_the_other(bundle: Path, tmp_path: Path) -> None:
    await kill_in(ROLES, bundle, tmp_path)


@pytest.mark.nightly
@pytest.mark.timeout(240)
@pytest.mark.parametrize("order", list(itertools.permutations(ROLES)), ids="-".join)
async def test_in_every_order(bundle: Path, tmp_path: Path, order: tuple[str, ...]) -> None:
    await kill_in(order, bundle, tmp_path)


@pytest.mark.faults
@pytest.mark.timeout(240)
async def test_viewers_of_a_killed_server_come_back_by_themselves(bundle: Path, tmp_path: Path) -> None:
    """All at once, to a server in its place, which takes them all on."""
    (tmp_path / "again").mkdir()
    with keep(bundle, tmp_path) as first:
        async with watching(first.url, 8) as viewers:
            first.process.send_signal(signal.SIGKILL)
            first.process.wait()
            with keep(bundle, tmp_path / "again", "--port", str(first.port)) as second:
                before = [len(viewer.arrivals) for viewer in viewers]
                await until(
                    lambda: all(len(v.arrivals) >= n + MORE_FRAMES for v, n in zip(viewers, before, strict=True)),
                    "somebody has not come back",
                )
                assert_quiet(second)


def assert_quiet(server: Keep) -> None:
    assert "Traceback" not in server.log.read_text()
    assert len(server.log_lines) <= 40, "a line for each who joins, and few more"
