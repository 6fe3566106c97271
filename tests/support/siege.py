"""A real server under attack: its process from outside, viewers that mean well, and attackers as processes."""

from __future__ import annotations

import asyncio
import contextlib
import json
import resource
import signal
import ssl
import subprocess
import sys
import time
from collections.abc import AsyncIterator, Callable, Iterator, Sequence
from contextlib import asynccontextmanager, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from cags_common.geometry import Intrinsics, Pose
from cags_common.transport import websocket
from cags_common.transport.base import ConnectionEndedError
from cags_protocol import PROTOCOL_VERSION, SUBPROTOCOL, ClientSession
from cags_protocol import events as ev
from cags_protocol.wire.limits import MAX_MESSAGE_BYTES
from cags_protocol.wire.messages import Control, Hello, PoseSample

CLIENT = Intrinsics.of_fov(320, 240, 1.2, 0.95)
FPS = 10.0
"""Rate at which good viewers watch: far below what the server can do, so that an attack is to blame for a miss."""

FAST = ("--train-splats", "4096", "--lod-order", "paper")

STARTING_S = 1.5
"""Until an attacker is at it."""

LEAST_KEPT, LONGEST_JOIN_S, MORE_MEMORY_MB, LINES_AT_ONCE = 0.9, 2.0, 150.0, 20
"""What the others must be left with: share of their quiet frames, time to join; and what an attack may cost."""

MORE_FRAMES, PATIENCE_S = 10, 60.0
"""What "frames go on" means, and how long it may take: beside other tests nothing is counted in real time."""

PAGE_BYTES = resource.getpagesize()


def now_us() -> int:
    return time.monotonic_ns() // 1000


def encode_small(folder: Path, scene: str = "procedural:size=1500,frames=20", *flags: str) -> Path:
    """A small bundle in ``folder``."""
    bundle = folder / "clip.cags"
    command = [sys.executable, "-m", "cags_encoder", scene, str(bundle), "--gof-frames", "10", *FAST, *flags]
    subprocess.run(command, check=True, capture_output=True)
    return bundle


@dataclass
class Keep:
    """A server's process, looked at from outside."""

    process: subprocess.Popen[str]
    log: Path
    port: int

    @property
    def url(self) -> str:
        """Where to watch."""
        return f"ws://127.0.0.1:{self.port}/stream"

    @property
    def rss_mb(self) -> float:
        """Resident memory."""
        pages = int(Path(f"/proc/{self.process.pid}/statm").read_text().split()[1])
        return pages * PAGE_BYTES / 1e6

    @property
    def descriptors(self) -> int:
        """Files and sockets that are open."""
        return len(list(Path(f"/proc/{self.process.pid}/fd").iterdir()))

    @property
    def cpu_s(self) -> float:
        """Processor time so far."""
        fields = Path(f"/proc/{self.process.pid}/stat").read_text().rsplit(")", 1)[1].split()
        return (int(fields[11]) + int(fields[12])) / 100

    @property
    def log_lines(self) -> list[str]:
        """What it has logged."""
        return self.log.read_text().splitlines()

    def stop(self) -> float:
        """Send SIGTERM; seconds until it has ended."""
        began = time.monotonic()
        self.process.send_signal(signal.SIGTERM)
        self.process.wait(20)
        return time.monotonic() - began


@contextmanager
def keep(bundle: Path, folder: Path, *flags: str, descriptors: int | None = None) -> Iterator[Keep]:
    """Serve ``bundle``; ``descriptors``: how many the server may have."""
    small = ["--reference-width", "128", "--reference-height", "96", "--render-threads", "1", "--drain-s", "0.5"]
    command = [sys.executable, "-m", "cags_server", "--bundle", str(bundle), "--port", "0", "--json", *small, *flags]
    if descriptors is not None:
        command = ["sh", "-c", f'ulimit -n {descriptors}; exec "$@"', "sh", *command]
    log = folder / "server.log"
    with log.open("w") as stderr:
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=stderr, text=True)
    assert process.stdout is not None
    try:
        line = process.stdout.readline()
        assert line, log.read_text()
        yield Keep(process, log, json.loads(line)["port"])
    finally:
        if process.poll() is None:
            process.kill()
        process.wait()
        process.stdout.close()


def _set() -> asyncio.Event:
    event = asyncio.Event()
    event.set()
    return event


@dataclass
class Viewer:
    """A viewer who means well: joins, plays in a loop, and notes when what came."""

    url: str
    token: str = ""
    header: bool = True
    tls: ssl.SSLContext | None = None
    rate_fps: float = FPS
    taking: asyncio.Event = field(default_factory=_set)
    """Cleared: it takes nothing from the connection until it is set again."""
    join_s: float | None = None
    """From the first packet to the Welcome."""
    arrivals: list[float] = field(default_factory=list)
    """When the end of a frame came, seconds."""
    late: int = 0
    """Frames that came after their display."""
    endings: list[str] = field(default_factory=list)

    async def watch(self) -> None:
        """Until cancelled; a lost session is begun again."""
        while True:
            with contextlib.suppress(ConnectionEndedError):
                await self._session()
            await asyncio.sleep(0.2)

    async def _session(self) -> None:
        began = time.monotonic()
        try:
            transport = await websocket.connect(
                self.url,
                subprotocol=SUBPROTOCOL,
                max_message_bytes=MAX_MESSAGE_BYTES,
                token=self.token if self.header else "",
                tls=self.tls,
            )
        except Exception as error:
            self.endings.append(str(error))
            return
        session = ClientSession(now_us=now_us())
        pose = Pose.looking_at((0.0, 0.5, 3.0), (0.0, 0.0, 0.0))
        session.hello(Hello(PROTOCOL_VERSION, CLIENT, pose, token=self.token), now_us=now_us())
        posing = asyncio.create_task(self._poses(session, transport, pose))
        self._fps, self._started_us = FPS, None
        try:
            while not session.closed:
                for data in session.data_to_send(now_us()):
                    await transport.send(data)
                data = await transport.recv()
                await self.taking.wait()
                session.receive(data, now_us=now_us())
                while (event := session.next_event()) is not None:
                    self._on_event(event, session, began)
        finally:
            posing.cancel()
            transport.abort()

    async def _poses(self, session: ClientSession, transport: Any, pose: Pose) -> None:
        with contextlib.suppress(ConnectionEndedError):
            while True:
                await asyncio.sleep(0.03)
                session.handle_timer(now_us=now_us())
                session.send_poses([PoseSample(now_us(), pose)], now_us=now_us())
                for data in session.data_to_send(now_us()):
                    await transport.send(data)

    def _on_event(self, event: Any, session: ClientSession, began: float) -> None:
        match event:
            case ev.Welcomed(welcome):
                self._fps, self._frames = welcome.fps, welcome.frames
                if self.join_s is None:
                    self.join_s = time.monotonic() - began
            case ev.FrameEnded():
                self.arrivals.append(time.monotonic())
                if self._started_us is None:
                    self._started_us = now_us() + 500_000
                    rate = self.rate_fps / self._fps
                    session.control(Control("play", 0, self._started_us, rate, loop=True), now_us=now_us())
            case ev.Refused(refusal):
                self.endings.append(f"refused: {refusal.message}")
            case ev.Closed(code, reason):
                self.endings.append(f"{code}: {reason}")

    def frames_between(self, from_s: float, to_s: float) -> int:
        """Frames whose end came between two times."""
        return sum(from_s <= at < to_s for at in self.arrivals)


@asynccontextmanager
async def watching(url: str, count: int = 2, **named: Any) -> AsyncIterator[list[Viewer]]:
    """Good viewers, playing."""
    viewers = [Viewer(url, **named) for _ in range(count)]
    tasks = [asyncio.create_task(viewer.watch()) for viewer in viewers]
    try:
        async with asyncio.timeout(20):
            while not all(len(viewer.arrivals) > 10 for viewer in viewers):  # noqa: ASYNC110
                await asyncio.sleep(0.05)
        yield viewers
    finally:
        await ended(tasks)


async def ended(tasks: Sequence[asyncio.Task[None]]) -> None:
    """Cancel them; raises what one of them has failed with."""
    for task in tasks:
        task.cancel()
    for result in await asyncio.gather(*tasks, return_exceptions=True):
        if isinstance(result, Exception):
            raise result


async def until(holds: Callable[[], bool], what: str) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not holds():
        assert time.monotonic() < deadline, what
        await asyncio.sleep(0.05)


async def frames_go_on(viewers: Sequence[Viewer]) -> None:
    """Everybody is shown more, and nobody has been sent away."""
    before = [len(viewer.arrivals) for viewer in viewers]
    await until(
        lambda: all(len(v.arrivals) >= n + MORE_FRAMES for v, n in zip(viewers, before, strict=True)),
        "the others' frames have stopped",
    )
    assert not any(viewer.endings for viewer in viewers)


@contextmanager
def attack(port: int, *attacks: str) -> Iterator[None]:
    """Some of :mod:`support.attackers`, each as ``NAME[:ARGUMENT[:TOKEN]]``, until the block ends."""
    here = Path(__file__).parent.parent
    command = [sys.executable, "-m", "support.attackers", str(port), *attacks]
    with subprocess.Popen(command, cwd=here, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "ready\n"
            yield
            assert process.poll() in (None, 0), f"{attacks} have failed"
        finally:
            process.kill()


@asynccontextmanager
async def attacked(port: int, *attacks: str) -> AsyncIterator[None]:
    """:func:`attack`, while the event loop goes on."""
    running = attack(port, *attacks)
    await asyncio.to_thread(running.__enter__)
    try:
        yield
    finally:
        await asyncio.to_thread(running.__exit__, None, None, None)


@dataclass
class Outcome:
    """What others saw of an attack."""

    quiet_fps: float
    under_fps: float
    join_s: float
    rss_mb: tuple[float, float]
    descriptors: tuple[int, int]
    lines: int
    cpu: float
    """Cores that the server was busy with."""
    seconds: float

    @property
    def kept(self) -> float:
        """Share of the quiet frames that came under attack: of the viewer who fared worst. 0 where the
        machine left no time for frames in peace either.
        """
        return self.under_fps / self.quiet_fps if self.quiet_fps else 0.0

    @property
    def well(self) -> bool:
        """Whether the others kept their frames, and one more could join."""
        return self.kept >= LEAST_KEPT and self.join_s <= LONGEST_JOIN_S

    def row(self, name: str) -> str:
        """A line of the table."""
        return (
            f"{name:28} frames kept {self.kept:5.2f}  join {self.join_s:5.2f} s  "
            f"RSS {self.rss_mb[0]:5.0f} -> {self.rss_mb[1]:5.0f} MB  "
            f"fds {self.descriptors[0]} -> {self.descriptors[1]}  "
            f"cores {self.cpu:4.2f}  log lines/s {self.lines / self.seconds:6.2f}"
        )


async def besiege(
    keep: Keep, sieges: Sequence[Sequence[str]], *, quiet_s: float = 2.0, attack_s: float = 4.0, **viewer: Any
) -> list[Outcome]:
    """Two viewers watch in peace, under one siege after the other, and in peace between them; in each, a third joins.

    What the machine is busy with may change: the peace before and that after a siege count, the poorer of the two.
    """
    outcomes: list[Outcome] = []
    async with watching(keep.url, 2, **viewer) as viewers:
        quiet = await _peace(viewers, quiet_s)
        for attacks in sieges:
            outcome = await _siege(keep, attacks, viewers, attack_s, viewer)
            await asyncio.sleep(0.5)
            again = await _peace(viewers, quiet_s)
            outcomes.append(replace(outcome, quiet_fps=min(quiet, again)))
            quiet = again
    return outcomes


async def _peace(viewers: Sequence[Viewer], seconds: float) -> float:
    """Frames a second of the viewer who gets fewest."""
    begun = time.monotonic()
    await asyncio.sleep(seconds)
    return min(each.frames_between(begun, begun + seconds) for each in viewers) / seconds


async def _siege(
    keep: Keep, attacks: Sequence[str], viewers: Sequence[Viewer], attack_s: float, viewer: dict[str, Any]
) -> Outcome:
    before = keep.rss_mb, keep.descriptors, len(keep.log_lines)
    async with attacked(keep.port, *attacks):
        await asyncio.sleep(STARTING_S)
        begun, cpu_s = time.monotonic(), keep.cpu_s
        newcomer = Viewer(keep.url, **viewer)
        joining = asyncio.create_task(newcomer.watch())
        await asyncio.sleep(attack_s)
        ended, cpu_s = time.monotonic(), keep.cpu_s - cpu_s
        joining.cancel()
        await asyncio.gather(joining, return_exceptions=True)
        after = keep.rss_mb, keep.descriptors, len(keep.log_lines)
    under = min(each.frames_between(begun, ended) for each in viewers) / (ended - begun)
    join_s = float("inf") if newcomer.join_s is None else newcomer.join_s
    seconds = ended - begun
    memory, descriptors = (before[0], after[0]), (before[1], after[1])
    lines = after[2] - before[2]
    return Outcome(0.0, under, join_s, memory, descriptors, lines, cpu_s / seconds, seconds + STARTING_S)


def assert_others_are_well(keep: Keep, *sieges: Sequence[str], **named: Any) -> None:
    """In each siege, a list of attacks beside each other, the good viewers keep their frames, a newcomer joins, and
    memory, descriptors and log stay small; afterwards the server ends when asked to.

    Frames are counted in real time: where a busy machine took them, those sieges are made once more.
    """
    left = list(sieges)
    for last in (False, True):
        outcomes = asyncio.run(besiege(keep, left, **named))
        rows = [outcome.row(" ".join(attacks)) for attacks, outcome in zip(left, outcomes, strict=True)]
        print(*rows, sep="\n")
        for attacks, outcome, row in zip(left, outcomes, rows, strict=True):
            assert outcome.rss_mb[1] - outcome.rss_mb[0] <= MORE_MEMORY_MB, row
            assert outcome.lines <= len(attacks) * (outcome.seconds + LINES_AT_ONCE), row
            assert not last or outcome.well, row
        left = [attacks for attacks, outcome in zip(left, outcomes, strict=True) if not outcome.well]
        if not left:
            break
    assert keep.stop() <= 1.5
