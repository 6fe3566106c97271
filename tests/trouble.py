"""Random faults in real time for an hour: ``python tests/trouble.py --minutes 60``.

Eight viewers watch one real server through a real shaper whose rate varies. Every few seconds, each viewer pauses,
jumps, stalls, loses its connection, leaves and returns, or sends a damaged message. At the end, every message that the
server queued must be delivered or dropped, memory must be within a tenth of its start, the numbers of descriptors,
threads and tasks must be as before, the log must be short, and all viewers must be able to watch. Prints one JSON
line; the exit status is 1 if a condition fails.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import os
import random
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from cags_common.transport.base import ConnectionEndedError
from cags_protocol import ClientSession
from cags_protocol.wire.messages import Control
from support.siege import PAGE_BYTES, Keep, Viewer, encode_small, ended, frames_go_on, keep, now_us, until
from support.wire_fuzz import fuzzed

VIEWERS = 8
LINK = ("--trace", "generated:lte-driving", "--delay-ms", "10", "--jitter-ms", "2")
PER_S = 0.2
"""Faults a second and viewer."""

FAULTS = {"pause": 4, "seek": 4, "stall": 2, "cut": 2, "leave": 1, "damage": 1}
"""Kinds of faults and their relative frequencies."""

STALLS_S = (0.2, 20.0)
"""Shortest and longest time for which a viewer reads nothing. The server ends a session after ten seconds of this
(``--slow-s``), or after fifteen seconds of silence.
"""

SETTLES_S = 20.0
"""Time until silent sessions have ended and freed memory is returned."""

WARMS_UP_S = 60.0
"""Warm-up with the same faults, after which caches (decoded tiles, threads) are full."""

MOST_GROWTH = 1.1
POOL = (os.cpu_count() or 1) + 4
"""Largest number of threads in an event loop's executor, which grows with concurrent blocking calls."""

LINES_A_FAULT = 3.0
"""Largest number of log lines per fault: the end of a session, its new start, and the error."""


@dataclass
class Troubled(Viewer):
    """A viewer that causes random faults."""

    rng: random.Random = field(default_factory=random.Random)
    suffered: Counter[str] = field(default_factory=Counter)
    calm: bool = False
    """Whether faults have stopped."""

    async def _poses(self, session: ClientSession, transport: Any, pose: Any) -> None:
        trouble = asyncio.create_task(self._trouble(session, transport))
        try:
            await super()._poses(session, transport, pose)
        finally:
            trouble.cancel()
            self.taking.set()

    async def _trouble(self, session: ClientSession, transport: Any) -> None:
        with contextlib.suppress(ConnectionEndedError):
            while True:
                await asyncio.sleep(self.rng.expovariate(PER_S))
                if not self.calm and self._started_us is not None:
                    (name,) = self.rng.choices(list(FAULTS), list(FAULTS.values()))
                    self.suffered[name] += 1
                    await getattr(self, f"_{name}")(session, transport)

    async def _pause(self, session: ClientSession, transport: Any) -> None:
        frame = self.rng.randrange(self._frames)
        session.control(Control("pause", frame, now_us()), now_us=now_us())
        await asyncio.sleep(self.rng.uniform(0.05, 5.0))
        self._play(session, frame)

    async def _seek(self, session: ClientSession, transport: Any) -> None:
        frame = self.rng.randrange(self._frames)
        session.control(Control("seek", frame, now_us()), now_us=now_us())
        self._play(session, frame)

    def _play(self, session: ClientSession, frame: int) -> None:
        rate = self.rate_fps / self._fps * self.rng.choice((0.5, 1.0, 1.0, 2.0))
        session.control(Control("play", frame, now_us() + 300_000, rate, loop=True), now_us=now_us())

    async def _stall(self, session: ClientSession, transport: Any) -> None:
        self.taking.clear()
        await asyncio.sleep(self.rng.uniform(*STALLS_S))
        self.taking.set()

    async def _cut(self, session: ClientSession, transport: Any) -> None:
        transport.abort()

    async def _leave(self, session: ClientSession, transport: Any) -> None:
        session.bye("for now", now_us=now_us())
        for data in session.data_to_send(now_us()):
            await transport.send(data)
        await transport.close()

    async def _damage(self, session: ClientSession, transport: Any) -> None:
        await transport.send(fuzzed(self.rng))


@dataclass(frozen=True)
class Footing:
    """Resources that a process holds."""

    rss_mb: float
    descriptors: int
    threads: int
    tasks: int = 0
    """Tasks of its event loop, if it reports them."""
    decoded_mb: float = 0.0
    """Decoded tiles that it keeps, within their bound, if it reports them."""


def footing(pid: int, tasks: int = 0, decoded_mb: float = 0.0) -> Footing:
    """The resources of a running process."""
    here = Path(f"/proc/{pid}")
    pages = int((here / "statm").read_text().split()[1])
    return Footing(
        round(pages * PAGE_BYTES / 1e6, 1),
        len(list((here / "fd").iterdir())),
        len(list((here / "task").iterdir())),
        tasks,
        decoded_mb,
    )


def metric(server: Keep, name: str) -> int:
    """One value of the metrics page."""
    with urllib.request.urlopen(f"http://127.0.0.1:{server.port}/metrics", timeout=60) as answer:
        lines = answer.read().decode().splitlines()
    (value,) = [line.split()[1] for line in lines if line.startswith(f"{name} ")]
    return round(float(value))


@contextmanager
def shaper(port: int) -> Iterator[tuple[int, str]]:
    """A shaper in front of the server at ``port``: its process id, and the address for viewers."""
    command = [sys.executable, "-m", "cags_shaper", "--listen", "127.0.0.1:0", "--to", f"127.0.0.1:{port}", "--json"]
    with subprocess.Popen([*command, *LINK], stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            yield process.pid, f"ws://127.0.0.1:{json.loads(process.stdout.readline())['port']}/stream"
            assert process.poll() is None, "the shaper has ended"
        finally:
            process.kill()


@dataclass
class Hour:
    """Result of a run."""

    minutes: float
    suffered: Counter[str]
    frames: int
    """Frame ends received by all viewers."""
    sessions: int
    queued: int
    """Messages queued by the server."""
    unsettled: int
    """Queued messages that were neither delivered nor dropped."""
    server: tuple[Footing, Footing]
    """Resources before and after, without viewers."""
    shaper: tuple[Footing, Footing]
    peak_mb: float
    lines: int
    tracebacks: int

    def faults(self) -> list[str]:
        """Descriptions of the conditions that failed."""
        out = [f"{self.unsettled} messages are unsettled"] if self.unsettled else []
        for who, (before, after) in (("server", self.server), ("shaper", self.shaper)):
            if after.rss_mb > MOST_GROWTH * before.rss_mb:
                out.append(f"the {who}'s memory: {before.rss_mb} -> {after.rss_mb} MB")
            for what in ("descriptors", "tasks"):
                was, now = getattr(before, what), getattr(after, what)
                if now != was:
                    out.append(f"the {who}'s {what}: {was} -> {now}")
            if after.threads > before.threads + POOL:
                out.append(f"the {who}'s threads: {before.threads} -> {after.threads}")
        if self.lines > LINES_A_FAULT * self.suffered.total() + 4 * VIEWERS:
            out.append(f"{self.lines} log lines about {self.suffered.total()} faults")
        if self.tracebacks:
            out.append(f"{self.tracebacks} tracebacks in the log")
        return out

    def line(self) -> dict[str, Any]:
        """The result as a JSON object."""
        return {**vars(self), **{who: [vars(each) for each in getattr(self, who)] for who in ("server", "shaper")}}


def unsettled(traces: Path) -> tuple[int, int]:
    """Number of queued messages in the event traces, and of those that were neither delivered nor dropped."""
    events: Counter[str] = Counter()
    for trace in traces.glob("*.jsonl"):
        with trace.open() as lines:
            next(lines)
            events.update(json.loads(line)["event"] for line in lines)
    return events["queued"], events["queued"] - events["delivered"] - events["dropped"]


async def play(server: Keep, shaping: int, url: str, seconds: float, seed: int) -> tuple[list[Troubled], Any, float]:
    """The viewers, the resources of both processes before and after, and the server's peak memory in MB."""
    first, then = (
        [Troubled(url, rng=random.Random(f"{seed} {begun} {n}")) for n in range(VIEWERS)] for begun in (0, 1)
    )
    await _watch(first, WARMS_UP_S, server)
    before = await _footings(server, shaping)
    peak_mb = await _watch(then, seconds, server)
    return first + then, (before, await _footings(server, shaping)), peak_mb


async def _watch(viewers: list[Troubled], seconds: float, server: Keep) -> float:
    tasks, peak_mb = [asyncio.create_task(viewer.watch()) for viewer in viewers], 0.0
    try:
        await until(lambda: all(viewer.arrivals for viewer in viewers), "somebody is not let in")
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s:
            await asyncio.sleep(min(1.0, seconds))
            peak_mb = max(peak_mb, server.rss_mb)
            for task in tasks:
                assert not task.done(), task.exception()
        for viewer in viewers:
            viewer.calm = True
        await asyncio.sleep(SETTLES_S)
        for viewer in viewers:
            viewer.endings.clear()
        await frames_go_on(viewers)
        return peak_mb
    finally:
        await ended(tasks)


async def _footings(server: Keep, shaping: int) -> tuple[Footing, Footing]:
    """Resources of server and shaper once all viewers have left."""
    await asyncio.sleep(SETTLES_S)
    assert await asyncio.to_thread(metric, server, "cags_sessions") == 0, "somebody is still there"
    tasks = await asyncio.to_thread(metric, server, "cags_tasks")
    decoded_mb = round(await asyncio.to_thread(metric, server, "cags_decoded_bytes") / 1e6, 1)
    await asyncio.sleep(1.0)  # until the connections that asked are gone
    return footing(server.process.pid, tasks, decoded_mb), footing(shaping)


def hour(folder: Path, minutes: float, seed: int) -> Hour:
    """Run for ``minutes``, with files in ``folder``."""
    bundle, traces = encode_small(folder), folder / "traces"
    with keep(bundle, folder, "--event-traces", str(traces)) as server, shaper(server.port) as (shaping, url):
        viewers, footings, peak_mb = asyncio.run(play(server, shaping, url, 60 * minutes, seed))
        sessions = metric(server, "cags_sessions_total")
        server.stop()
        words = server.log.read_text()
    queued, left = unsettled(traces)
    (server_before, shaper_before), (server_after, shaper_after) = footings
    return Hour(
        minutes=minutes,
        suffered=sum((viewer.suffered for viewer in viewers), Counter()),
        frames=sum(len(viewer.arrivals) for viewer in viewers),
        sessions=sessions,
        queued=queued,
        unsettled=left,
        server=(server_before, server_after),
        shaper=(shaper_before, shaper_after),
        peak_mb=round(peak_mb, 1),
        lines=len(words.splitlines()),
        tracebacks=words.count("Traceback"),
    )


def main(arguments: list[str] | None = None) -> int:
    """Run it and print the result."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=60.0, help="duration in minutes (default: 60)")
    parser.add_argument("--seed", type=int, default=1, help="random seed of the faults (default: 1)")
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory(prefix="cags-trouble-") as folder:
        outcome = hour(Path(folder), options.minutes, options.seed)
    faults = outcome.faults()
    load = [round(each, 1) for each in os.getloadavg()]
    print(json.dumps({**outcome.line(), "seed": options.seed, "load": load, "faults": faults}), flush=True)
    return int(bool(faults))


if __name__ == "__main__":
    sys.exit(main())
