"""Moves a client's bytes: a transport on one side, a :class:`~cags_server.session.connection.Connection` on the other.

Three coroutines share the connection: one reads, one writes, one plans frames and runs their jobs in an executor. All
run in one event loop, so the connection needs no lock; only jobs leave the loop.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable, Coroutine
from concurrent.futures import Executor
from typing import Any

from cags_common.errors import CagsError
from cags_common.runtime.rare_log import RareLog
from cags_common.runtime.tasks import watched
from cags_common.runtime.wake import woken
from cags_common.transport.base import ConnectionEndedError, Transport
from cags_protocol.wire.messages import RefusalCode
from cags_server.http.shortage import ShortageLog
from cags_server.reference.job import FrameJob
from cags_server.session.connection import Connection
from cags_server.session.quota import ReadingShare

BATCH_BYTES = 64 * 1024
"""Bytes taken from the session at once; the rest is decided later, when more is known."""

READING_TURN_S = 0.002
"""Time that a client may have its messages read before the others have a turn. With one message a turn, twenty viewers
whose frames are planned together read acknowledgements a second late, and their credit runs out.
"""

CLOSE_TIMEOUT_S = 2.0

FAILING_S = 3.0
"""How long frames may fail, one after the other, before the viewer is told and let go."""

log = logging.getLogger(__name__)
told = RareLog(log, 10.0)
"""Of what goes on failing, such as a bundle that is gone: a line in ten seconds, whoever meets it."""

tracebacks = RareLog(log, 60.0)
"""Of faults of this program: each place in the code once a minute, whoever meets it."""


def now_us() -> int:
    """The server's clock."""
    return time.monotonic_ns() // 1000


class ClientTask:
    """One client's coroutines. ``run`` returns when the session is over."""

    def __init__(
        self,
        transport: Transport,
        connection: Connection,
        executor: Executor,
        *,
        slow_s: float,
        clients: Callable[[], int] = lambda: 1,
    ) -> None:
        """``clients()``: how many share the event loop."""
        self._transport, self._connection, self._executor = transport, connection, executor
        self._share = ReadingShare(clients, time.perf_counter())
        self._slow_s = slow_s
        self._to_send = asyncio.Event()
        self._to_plan = asyncio.Event()
        self._work = set[asyncio.Task[None]]()  # jobs and reads, off the loop
        self._parts: list[asyncio.Task[None]] = []
        self._failing_since_s: float | None = None
        self._shortage = ShortageLog(log, connection.name, time.monotonic)

    async def run(self) -> None:
        """Serve until the client or the server leaves."""
        self._parts = [watched(part(), self._unexpected) for part in (self._read, self._write, self._plan)]
        try:
            await asyncio.wait(self._parts, return_when=asyncio.FIRST_COMPLETED)
            await asyncio.sleep(0)  # what a part has raised is told, and ends the session, before anything else does
            if not self._connection.closed:
                self._connection.connection_lost("the connection ended", now_us())
            await self._flush()
        finally:
            if not self._connection.closed:  # cancelled, with the request that it serves
                self._connection.connection_lost("the connection ended", now_us())
            tasks = [*self._parts, *self._work]
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            self._parts = []

    def _unexpected(self, error: BaseException) -> None:
        """End the session for a fault: with a word to the viewer, and with a line or a traceback in the log."""
        if isinstance(error, ConnectionEndedError):
            return
        name = self._connection.name
        if isinstance(error, CagsError):
            told.write(logging.ERROR, "ended", "%s: ended, as the scene cannot be read: %s", name, error)
            words = "the server cannot read the scene at present; join again later"
        else:
            tracebacks.write(logging.ERROR, _place(error), "%s: ended by a fault: %s", name, error, error=error)
            words = "the server failed; join again"
        try:
            self._connection.fail(words, now_us())
        except Exception as another:  # what is broken may be asked once more while it ends
            tracebacks.write(logging.ERROR, _place(another), "%s: %s", name, another, error=another)
        self._wake()

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
        turn_s = 0.0
        while not self._connection.closed:
            data = await self._transport.recv()
            began_s = time.thread_time()  # of work: on a busy machine much more time passes
            self._connection.receive(data, now_us())
            self._wake()
            worked_s = time.thread_time() - began_s
            wait_s, turn_s = self._share.took(worked_s, time.perf_counter()), turn_s + worked_s
            if wait_s or turn_s > READING_TURN_S:
                turn_s = 0.0
                await asyncio.sleep(wait_s)  # at least a turn of everybody else's

    async def _write(self) -> None:
        while not self._connection.closed:
            self._to_send.clear()
            packets = self._connection.data_to_send(now_us(), BATCH_BYTES)
            for packet in packets:
                if not await self._sent(packet):
                    return
            if not packets:
                self._to_plan.set()  # the next packet may be due at a later time: wait for that, too
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
                self._shortage.look(self._connection.stats)
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
        task = watched(work, self._unexpected)
        self._work.add(task)
        task.add_done_callback(self._work.discard)

    async def _fetch(self, frame: int) -> None:
        """Read from the store, which may take seconds, while the loop serves others."""
        try:
            await asyncio.to_thread(self._connection.fetch, frame)
        except CagsError as error:
            name = self._connection.name
            told.write(logging.WARNING, "fetch", "%s: frame %d was not read: %s", name, frame, error)
        self._connection.fetched(frame, now_us())
        self._wake()

    async def _run(self, job: FrameJob, loop: asyncio.AbstractEventLoop) -> None:
        try:
            render = await loop.run_in_executor(self._executor, job.run, time.perf_counter_ns)
        except CagsError as error:  # of the bundle's store: the next frame may be read again
            name = self._connection.name
            told.write(logging.WARNING, "job", "%s: frame %d has no reference: %s", name, job.plan.frame, error)
            self._connection.job_failed(job, now_us())
            self._failing_since_s = self._failing_since_s or time.monotonic()
            if time.monotonic() - self._failing_since_s > FAILING_S:
                raise
        except BaseException:
            self._connection.job_failed(job, now_us())
            raise
        else:
            self._failing_since_s = None
            self._connection.job_done(render, now_us())
        self._wake()
        plan = job.plan
        self._executor.submit(job.library.prepare, plan.frame + 1, plan.ahead.frame + 1, drawn=plan.speaks)

    async def _flush(self) -> None:
        """Write the last words; a client that does not take them is cut off."""
        try:
            async with asyncio.timeout(CLOSE_TIMEOUT_S):
                for packet in self._connection.data_to_send(now_us()):
                    await self._transport.send(packet)
                await self._transport.close(self._farewell())
        except (TimeoutError, ConnectionEndedError):
            self._transport.abort()  # else what it does not take is kept for it, with the socket

        except Exception as error:
            tracebacks.write(logging.ERROR, _place(error), "%s: %s", self._connection.name, error, error=error)
            self._transport.abort()

    def _farewell(self) -> str:
        ending = self._connection.ending
        return ending.reason if ending else ""

    def _wake(self) -> None:
        self._to_send.set()
        self._to_plan.set()


def _place(error: BaseException) -> tuple[type[BaseException], str, int]:
    """Where an error was raised: one fault has one place, however many sessions meet it."""
    frame = error.__traceback__
    while frame is not None and frame.tb_next is not None:
        frame = frame.tb_next
    return (
        type(error),
        "" if frame is None else frame.tb_frame.f_code.co_filename,
        0 if frame is None else frame.tb_lineno,
    )
