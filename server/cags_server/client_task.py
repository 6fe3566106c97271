"""Moves one client's bytes: a transport on one side, a :class:`~cags_server.connection.Connection` on the other.

Three coroutines share the connection: one reads, one writes, one plans frames and runs their jobs in an executor. All
run in one event loop, so the connection needs no lock; only jobs leave the loop.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Coroutine
from concurrent.futures import Executor
from typing import Any

from cags_common.errors import CagsError
from cags_common.transport.base import ConnectionEndedError, Transport
from cags_common.wake import woken
from cags_protocol.messages import RefusalCode
from cags_server.connection import Connection
from cags_server.reference import FrameJob

BATCH_BYTES = 64 * 1024
"""Bytes taken from the session at once; the rest is decided later, when more is known."""

CLOSE_TIMEOUT_S = 2.0

log = logging.getLogger(__name__)


def now_us() -> int:
    """The server's clock."""
    return time.monotonic_ns() // 1000


class ClientTask:
    """One client's coroutines. ``run`` returns when the session is over."""

    def __init__(self, transport: Transport, connection: Connection, executor: Executor, *, slow_s: float) -> None:
        self._transport, self._connection, self._executor = transport, connection, executor
        self._slow_s = slow_s
        self._to_send = asyncio.Event()
        self._to_plan = asyncio.Event()
        self._work = set[asyncio.Task[None]]()  # jobs and reads, off the loop

    async def run(self) -> None:
        """Serve until the client or the server leaves."""
        tasks = [asyncio.create_task(part()) for part in (self._read, self._write, self._plan)]
        try:
            ended, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            if any(_failed(task) for task in ended):
                self._connection.session.refuse(
                    RefusalCode.INTERNAL, "", "the server failed; join again", now_us=now_us()
                )
            if not self._connection.closed:
                self._connection.connection_lost("the connection ended", now_us())
            await self._flush()
        finally:
            if not self._connection.closed:  # cancelled, with the request that it serves
                self._connection.connection_lost("the connection ended", now_us())
            tasks += self._work
            for task in tasks:
                task.cancel()
            results = await asyncio.gather(*tasks, return_exceptions=True)
            for result in results:
                if isinstance(result, Exception) and not isinstance(result, ConnectionEndedError):
                    log.error("%s: %s", self._connection.name, result, exc_info=result)

    @property
    def peer(self) -> str:
        """Address of the client."""
        return self._transport.peer

    def say_goodbye(self, reason: str) -> None:
        """End the session; the coroutines finish by themselves."""
        self._connection.close(reason, now_us())
        self._wake()

    def cut(self, reason: str) -> None:
        """End a session that has not begun, without waiting for its peer."""
        self.say_goodbye(reason)
        self._transport.abort()

    async def _read(self) -> None:
        while not self._connection.closed:
            self._connection.receive(await self._transport.recv(), now_us())
            self._wake()

    async def _write(self) -> None:
        while not self._connection.closed:
            self._to_send.clear()
            packets = self._connection.data_to_send(now_us(), BATCH_BYTES)
            for packet in packets:
                if not await self._sent(packet):
                    return
            if not packets:
                await self._to_send.wait()

    async def _sent(self, packet: bytes) -> bool:
        """Write one packet; False for a client that does not take it in time, whose session is over then."""
        try:
            async with asyncio.timeout(self._slow_s):
                await self._transport.send(packet)
        except TimeoutError:
            reason = f"the client took longer than {self._slow_s:g} s for one packet"
            self._connection.session.refuse(RefusalCode.TIMEOUT, "", reason, now_us=now_us())
            return False
        return True

    async def _plan(self) -> None:
        loop = asyncio.get_running_loop()
        while not self._connection.closed:
            self._to_plan.clear()
            now = now_us()
            timer = self._connection.next_timer_us()
            if timer is not None and timer <= now:
                self._connection.handle_timer(now)
                self._to_send.set()
            frame = self._connection.next_fetch()
            if frame is not None:
                self._begin(self._fetch(frame))
            job = self._connection.next_job(now)
            if job is not None:
                self._begin(self._run(job, loop))
                continue
            timer = self._connection.next_timer_us()
            await woken(self._to_plan, None if timer is None else (timer - now_us()) / 1e6)

    def _begin(self, work: Coroutine[Any, Any, None]) -> None:
        task = asyncio.create_task(work)
        self._work.add(task)
        task.add_done_callback(self._work.discard)

    async def _fetch(self, frame: int) -> None:
        """Read from the store, which may take seconds, while the loop serves others."""
        try:
            await asyncio.to_thread(self._connection.fetch, frame)
        except CagsError as error:
            log.warning("%s: frame %d was not read: %s", self._connection.name, frame, error)
        self._connection.fetched(frame, now_us())
        self._wake()

    async def _run(self, job: FrameJob, loop: asyncio.AbstractEventLoop) -> None:
        try:
            render = await loop.run_in_executor(self._executor, job.run, time.perf_counter_ns)
            self._connection.job_done(render, now_us())
        except Exception:
            log.exception("%s: frame %d failed", self._connection.name, job.plan.frame)
            self._connection.job_failed(job)
        self._wake()
        self._executor.submit(job.library.prepare, job.plan.frame + 1)

    async def _flush(self) -> None:
        """Write the last words; a client that does not take them is cut off."""
        try:
            async with asyncio.timeout(CLOSE_TIMEOUT_S):
                for packet in self._connection.data_to_send(now_us()):
                    await self._transport.send(packet)
                await self._transport.close(self._farewell())
        except (TimeoutError, ConnectionEndedError):
            self._transport.abort()  # else what it does not take is kept for it, with the socket

    def _farewell(self) -> str:
        ending = self._connection.ending
        return ending.reason if ending else ""

    def _wake(self) -> None:
        self._to_send.set()
        self._to_plan.set()


def _failed(task: asyncio.Task[None]) -> bool:
    """Whether a coroutine ended by a fault of the program: not because the client went away."""
    error = None if task.cancelled() else task.exception()
    return error is not None and not isinstance(error, ConnectionEndedError)
