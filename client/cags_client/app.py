"""The client in real time: sockets, a clock and executors around the :class:`~cags_client.playback.player.Player`.

The event loop moves bytes and starts work. Decoding, drawing and sinks have one thread each, so neither a burst of
tiles nor a slow disk delays the display.
"""

from __future__ import annotations

import asyncio
import random
import signal
import time
from collections.abc import Awaitable, Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import Any

from cags_client.frame.presented import PresentedFrame
from cags_client.interrupts import interrupts
from cags_client.net.connection import FAREWELL_S, LEISURELY_S, Connection
from cags_client.net.endpoints import Endpoints
from cags_client.output.report import frame_stats
from cags_client.output.sinks import FrameSink, LiveSink
from cags_client.playback.jobs import Decode, Present
from cags_client.playback.player import Player
from cags_client.playback.viewpoint import PoseSource
from cags_client.settings import AUTO, OFF, ClientSettings, LiveSettings
from cags_common.errors import CagsError, NetworkError
from cags_common.runtime.wake import woken
from cags_common.transport import Transport
from cags_protocol.sessions.client import ClientSession

SINK_BACKLOG = 8
"""Largest number of frames waiting for the sinks; beyond it the display waits, and frames are late."""


def now_us() -> int:
    """The client's clock: microseconds, monotonic."""
    return time.monotonic_ns() // 1000


@dataclass(eq=False)
class Playback:
    """Results of a play."""

    player: Player
    frames: list[dict[str, Any]] = field(default_factory=list)
    """One record per presented frame (see :func:`cags_client.output.report.frame_stats`)."""
    ended_by: signal.Signals | None = None
    """The signal that asked for the end, if any."""

    @property
    def error(self) -> CagsError | None:
        """What has ended the play early, if anything."""
        return self.player.error

    def checked(self) -> Playback:
        """Itself. Raises :attr:`error` if nothing was shown before it: there are no results then."""
        if self.error is not None and not self.frames:
            raise self.error
        return self


async def play(
    url: str,
    settings: ClientSettings,
    poses: PoseSource,
    sinks: Sequence[FrameSink],
    *,
    near: float,
    live: LiveSettings | None = None,
    on_frame: Callable[[dict[str, Any]], None] | None = None,
) -> Playback:
    """Play to the end of the clip or of ``settings.duration``. After an interrupt, a request to end or an error
    (:attr:`Playback.error`) it returns the results up to then. Raises :class:`CagsError` if nothing was shown.

    ``url`` may name several servers, separated by commas. The first that has room is used; after a dropped connection
    the same server is tried, and then the next.
    """
    settings = looked_at(settings, sinks)
    endpoints = Endpoints(url, settings.token, settings.ca)
    transport = await endpoints.first()
    player = Player(
        ClientSession(now_us=now_us()),
        settings,
        poses,
        now_us=now_us(),
        near=near,
        live=live,
        clock=time.perf_counter,
        rng=random.Random(),  # noqa: S311 - spreads attempts in time
        others=endpoints.others,
    )
    shell = Shell(transport, player, sinks, on_frame, endpoints.again)
    with interrupts(shell.leave):
        try:
            await shell.run()
        finally:
            shell.close()
    return Playback(shell.player, shell.records, shell.ended_by).checked()


def looked_at(settings: ClientSettings, sinks: Sequence[FrameSink]) -> ClientSettings:
    """``settings`` without interpolated pictures, unless they were requested or there is a live display."""
    if settings.interpolate == AUTO and not any(isinstance(sink, LiveSink) for sink in sinks):
        return replace(settings, interpolate=OFF)
    return settings


class Shell:
    """Runs a player in an event loop, over one connection after another."""

    def __init__(
        self,
        transport: Transport,
        player: Player,
        sinks: Sequence[FrameSink],
        on_frame: Callable[[dict[str, Any]], None] | None,
        connect: Callable[[int], Awaitable[Transport]],
    ) -> None:
        """``connect`` opens another connection, given the number of the attempt."""
        self.records: list[dict[str, Any]] = []
        self.ended_by: signal.Signals | None = None
        self.player = player
        self._on_frame = on_frame
        self._sinks, self._connect = sinks, connect
        self._transport = transport
        self._coming_back: asyncio.Task[None] | None = None
        self._wake, self._caught_up = asyncio.Event(), asyncio.Event()
        self._decoder, self._drawer, self._writer = (ThreadPoolExecutor(1, name) for name in ("decode", "draw", "sink"))
        self._backlog = asyncio.Semaphore(SINK_BACKLOG)
        self._tasks: set[asyncio.Task[None]] = set()
        self._failure: BaseException | None = None
        self._closing = False

    async def run(self) -> None:
        """Run until the player has finished, the connection is lost, or a sink fails."""
        self._open_line(self._transport)
        try:
            while not self.player.finished and self._failure is None:
                await self._turn()
            self._line.send(self.player.data_to_send(now_us()))
        finally:
            self._reader.cancel()
            if self._coming_back is not None:
                self._coming_back.cancel()
            self._closing = True
            farewell = self._line.close(LEISURELY_S if self.ended_by is None else FAREWELL_S)
            await asyncio.gather(self._reader, *self._tasks, farewell, return_exceptions=True)
        if self._failure is not None:
            raise self._failure

    def leave(self, number: signal.Signals) -> None:
        """A signal asks for the end: say goodbye and stop."""
        self.ended_by = number
        self.player.leave(now_us())
        self.wake()
        if self._closing:
            self._line.hurry()

    def wake(self) -> None:
        """The player's state has changed: start the work that follows from it."""
        self._wake.set()

    def close(self) -> None:
        """End the threads."""
        for executor in (self._decoder, self._drawer, self._writer):
            executor.shutdown(wait=True, cancel_futures=True)

    async def _turn(self) -> None:
        self._wake.clear()
        timer = self.player.next_timer_us()
        if timer is not None and timer <= now_us():
            self.player.handle_timer(now_us())
        self._line.send(self.player.data_to_send(now_us()))
        if self.player.wants_connection(now_us()):
            self._reader.cancel()  # now: its end would count as the end of the attempt
            self._coming_back = self._start(self._come_back())
        while (action := self.player.next_action(now_us())) is not None:
            self._start(self._decode(action) if isinstance(action, Decode) else self._present(action))
        if not self.player.backed_up:
            self._caught_up.set()
        if self.player.finished:  # changed by a timer or by a failed write, which would not wake this task
            return
        timer = self.player.next_timer_us()
        await woken(self._wake, None if timer is None else (timer - now_us()) / 1e6)

    def _lost(self, line: Connection, reason: str) -> None:
        """Writing has found the connection closed."""
        if (
            line is self._line and not self.player.away
        ):  # otherwise a new one is being opened, or the reader will report it
            self.player.lost(reason, now_us())
        self._wake.set()

    async def _read(self, transport: Transport) -> None:
        try:
            while True:
                data = await transport.recv()
                self.player.receive(data, now_us())
                self._wake.set()
                if self.player.backed_up:
                    self._caught_up.clear()
                    await self._caught_up.wait()
        except NetworkError as error:
            self.player.lost(str(error), now_us())
        finally:
            self._wake.set()

    async def _come_back(self) -> None:
        """Open another connection to replace the lost one, from which nothing more is read."""
        await asyncio.gather(self._reader, return_exceptions=True)
        old = self._line
        try:
            transport = await self._connect(self.player.attempts)
        except NetworkError as error:
            self.player.lost(str(error), now_us())
            return
        if self.player.finished:
            await transport.close()
            return
        self._open_line(transport)
        self.player.connected(now_us())
        await old.close()

    def _open_line(self, transport: Transport) -> None:
        """Write to and read from a connection; an error while reading ends playback."""
        self._line = Connection(transport, self._lost)
        self._reader = asyncio.create_task(self._read(transport))
        self._reader.add_done_callback(self._ended)

    def _start(self, work: Any) -> asyncio.Task[None]:
        task = asyncio.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._ended)
        return task

    def _ended(self, task: asyncio.Task[None]) -> None:
        self._tasks.discard(task)
        if not task.cancelled() and task.exception() is not None:
            self._failure = self._failure or task.exception()
        self._wake.set()

    async def _decode(self, action: Decode) -> None:
        result = await asyncio.get_running_loop().run_in_executor(self._decoder, action.run)
        self.player.done(action, result, now_us())

    async def _present(self, action: Present) -> None:
        presented = await asyncio.get_running_loop().run_in_executor(self._drawer, action.run)
        shown_us = now_us()
        if not action.media:
            await self._show(lambda: self._show_between(presented))
            self.player.done(action, presented, now_us())
            return
        record = frame_stats(presented, action, shown_us)
        self.records.append(record)
        if self._on_frame is not None:
            self._on_frame(record)
        await self._show(lambda: self._show_frame(presented, record))
        self.player.done(action, presented, now_us())

    def _show_frame(self, presented: PresentedFrame, record: dict[str, Any]) -> None:
        for sink in self._sinks:
            sink.show(presented, record)

    def _show_between(self, presented: PresentedFrame) -> None:
        for sink in self._sinks:
            if isinstance(sink, LiveSink):
                sink.show_between(presented)

    async def _show(self, show: Callable[[], None]) -> None:
        """Pass a picture to the sinks, off the display path; wait if they are too far behind."""
        await self._backlog.acquire()
        self._start(self._sink(show))

    async def _sink(self, show: Callable[[], None]) -> None:
        try:
            await asyncio.get_running_loop().run_in_executor(self._writer, show)
        finally:
            self._backlog.release()


def run_playback(*arguments: Any, **named: Any) -> Playback:
    """:func:`play` in an event loop of its own."""
    return asyncio.run(play(*arguments, **named))


def close_sinks(sinks: Sequence[FrameSink], *, completed: bool) -> None:
    """Close all sinks, even if one raises; the first error is raised at the end."""
    failure: CagsError | None = None
    for sink in sinks:
        try:
            sink.close(completed=completed)
        except CagsError as error:
            failure = failure or error
    if failure is not None and completed:
        raise failure
