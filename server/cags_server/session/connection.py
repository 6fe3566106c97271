"""One client, without IO: its protocol session and its streamer, joined.

The owner moves bytes (``receive`` in, ``data_to_send`` out), runs the jobs that ``next_job`` gives and reports them
by ``job_done`` or ``job_failed``, and calls ``handle_timer`` when ``next_timer_us`` is reached. The server's shell
does that in real time, the simulator in virtual time. An owner that must not wait for the bundle's store says so
(``fetches``), and reads elsewhere what ``next_fetch`` names.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

from cags_common.errors import ProtocolError
from cags_protocol import ServerSession
from cags_protocol import events as ev
from cags_protocol.sessions.server import ServerSessionSettings
from cags_protocol.sessions.tracing import EventTrace
from cags_protocol.wire.inventory import unpack_inventory
from cags_protocol.wire.messages import Blob, Buffer, Hello, RefusalCode
from cags_server.fov.limits import undrawable
from cags_server.link import LinkState, MeasuredLink
from cags_server.records import StreamStats
from cags_server.reference.job import FrameJob, FrameRender
from cags_server.reference.render_slots import RenderSlots
from cags_server.scene.library import SceneLibrary
from cags_server.session.quota import ClientQuota, Quotas
from cags_server.session.streamer import Streamer
from cags_server.settings import ServerSettings

Admission = Callable[[Hello], tuple[RefusalCode, str, str] | None]
"""Judges a Hello: None lets the client in, (code, field, message) refuses it."""


class Connection:
    """One client from its first byte to its last. All times are the server's clock."""

    def __init__(
        self,
        library: SceneLibrary,
        settings: ServerSettings,
        *,
        name: str,
        now_us: int,
        link: LinkState | None = None,
        session_settings: ServerSessionSettings | None = None,
        admit: Admission | None = None,
        quotas: Quotas | None = None,
        render_slots: RenderSlots | None = None,
        trace: EventTrace | None = None,
        fetches: bool = False,
    ) -> None:
        """``render_slots``: the renderer's places, shared with other clients; without them there is always room.

        ``trace`` hears of every step of sending. ``fetches``: the owner asks :meth:`next_fetch` and reads; else what is
        needed is read from the store when it is needed.
        """
        self.name = name
        self.session = ServerSession(session_settings, now_us=now_us, trace=trace)
        self.streamer: Streamer | None = None
        self.ending: ev.Closed | None = None
        """How the session ended; None while it goes on."""
        self._library, self._settings, self._admit = library, settings, admit
        self._link = link or MeasuredLink()
        self._render_slots, self._rendering = render_slots, False
        self._quota = ClientQuota(quotas or Quotas(), now_us)
        self._fetches, self._unopened = fetches, False
        self._fetching: int | None = None  # media frame
        self._asked_ahead: int | None = None  # the frame asked for last that the stream does not wait for
        self._fetched: set[int] = set()  # of the frames that are needed: those that were at hand once
        self._stats = StreamStats()

    @property
    def closed(self) -> bool:
        """Whether the session is over; what ``data_to_send`` still returns should be written."""
        return self.session.closed

    @property
    def stats(self) -> StreamStats:
        """What the stream did so far, or until it ended."""
        return self.streamer.stats if self.streamer else self._stats

    def receive(self, data: Buffer, now_us: int) -> None:
        """Take one message of the client. One that sends more than its quota is refused."""
        self._enforce(self._quota.message(len(data), now_us), now_us)
        self.session.receive(data, now_us=now_us)
        self._settle(now_us)

    def data_to_send(self, now_us: int, max_bytes: int | None = None) -> list[bytes]:
        """Messages that may be written now, most valuable first."""
        data = self.session.data_to_send(now_us, max_bytes)
        self._settle(now_us)
        return data

    def next_timer_us(self) -> int | None:
        """When ``handle_timer`` (and then ``next_job``) should be called next."""
        times = [self.session.next_timer_us()]
        if self.streamer is not None:
            times.append(self.streamer.mark_due_us)
        if self.streamer is not None and self._needed() is None:
            times += [self.streamer.next_due_us(), self.streamer.startup_due_us()]
        known = [t for t in times if t is not None]
        return min(known) if known and not self.closed else None

    def handle_timer(self, now_us: int) -> None:
        """Do what is due."""
        self.session.handle_timer(now_us=now_us)
        if self.streamer is not None and not self.closed:
            self.streamer.mark_if_due(now_us)
            self._queue_marks(self.streamer, now_us)
        if self.streamer is not None and not self.closed and self._needed() is None:
            self._recall(self.streamer, now_us)
            outgoing = self.streamer.end_startup(now_us) + self.streamer.catch_up(now_us)
            self._queue_marks(self.streamer, now_us)
            self._queue(outgoing, now_us)
        self._settle(now_us)

    def next_fetch(self) -> int | None:
        """A media frame to read from the store (:meth:`fetch`, on any thread) before the stream can go on, or soon.

        One at a time; its end is told to :meth:`fetched`.
        """
        if self.closed or self._fetching is not None:
            return None
        self._fetching = self._needed()
        if self._fetching is None and self._unopened and self.streamer is not None:
            # Read for somebody else since the client joined: a fetch that finds it there still opens the stream.
            self._fetching = self.streamer.first_frame
        if self._fetching is None and self.streamer is not None and self.streamer.next_opening != self._asked_ahead:
            self._fetching = self._asked_ahead = self.streamer.next_opening  # once: it may not be readable
        return self._fetching

    def fetch(self, frame: int) -> None:
        """Read ``frame``: what planning it and sending its tiles needs."""
        self._library.fetch(frame)

    def fetched(self, frame: int, now_us: int) -> None:
        """``frame`` was read, or could not be: then reading it where it is needed tells why."""
        self._fetching = None
        self._fetched.add(frame)
        if self.streamer is not None and self._unopened and not self.closed:
            self._open(self.streamer, now_us)
            self._settle(now_us)

    def _needed(self) -> int | None:
        """The media frame that the stream waits for; None where it can go on."""
        if not self._fetches or self.streamer is None:
            return None
        streamer = self.streamer
        wanted = (streamer.first_frame,) if self._unopened else streamer.next_frames
        self._fetched.intersection_update(wanted)
        for frame in wanted:
            if frame not in self._fetched:
                if not self._library.at_hand(frame):
                    return frame
                self._fetched.add(frame)
        return None

    def next_job(self, now_us: int) -> FrameJob | None:
        """The next frame to render, if one is due and none is being rendered."""
        if self.streamer is None or self.closed or self._needed() is not None:
            return None
        job = self.streamer.begin(now_us)
        self._queue_marks(self.streamer, now_us)
        if job is not None and self._render_slots is not None:
            self._render_slots.begun(self.name, now_us, self._lacking, look=not job.plan.speaks)
            self._rendering = True
        return job

    def job_done(self, render: FrameRender, now_us: int) -> None:
        """A job has ended well."""
        self._render_ended(now_us, render)
        if self.streamer is not None and not self.closed:
            self._recall(self.streamer, now_us)
            outgoing = self.streamer.finish(render, now_us)
            self._queue_marks(self.streamer, now_us)
            self._queue(outgoing, now_us)
            self._settle(now_us)

    def job_failed(self, job: FrameJob, now_us: int) -> None:
        """A job has raised; the stream goes on with the next frame."""
        self._render_ended(now_us)
        if self.streamer is not None:
            self.streamer.abandon(job)

    def _may_render(self, now_us: int) -> bool:
        if self._render_slots is None or self.streamer is None:
            return True
        return self._render_slots.may(self.name, now_us, self.streamer.wait_us, self._lacking)

    @property
    def _lacking(self) -> float | None:
        return None if self.streamer is None else self.streamer.lacking

    def _lightly(self) -> bool:
        return self._render_slots is not None and self._render_slots.light

    def _render_ended(self, now_us: int, render: FrameRender | None = None) -> None:
        if self._render_slots is not None and self._rendering:
            whole = render is not None and render.plan.speaks
            took_us = render.took_us if render is not None and whole else None
            self._render_slots.ended(now_us, took_us, light=render is not None and render.plan.light)
        self._rendering = False

    def release(self, now_us: int) -> None:
        """Give back the renderer's place and turn, and all that was kept for the client, who is gone.

        The streamer asks this object whether it may render: left as they are, both would wait for a collection of
        cycles, with an encoder's pictures and a client's inventory.
        """
        self._render_ended(now_us)
        if self._render_slots is not None:
            self._render_slots.left(self.name)
        self._stats, self.streamer, self._admit = self.stats, None, None

    def connection_lost(self, reason: str, now_us: int) -> None:
        """The transport ended by itself."""
        self.session.connection_lost(reason, now_us=now_us)
        self._settle(now_us)

    def close(self, reason: str, now_us: int) -> None:
        """Say goodbye; the message is in ``data_to_send``."""
        self.session.bye(reason, now_us=now_us)
        self._settle(now_us)

    def fail(self, reason: str, now_us: int) -> None:
        """End the session for a fault of the server, of which the viewer is told ``reason``."""
        self.session.refuse(RefusalCode.INTERNAL, "", reason, now_us=now_us)
        self._settle(now_us)

    def _settle(self, now_us: int) -> None:
        """Pass on every event of the session, and whatever those cause."""
        while (event := self.session.next_event()) is not None:
            if isinstance(event, ev.Joined):
                self._join(event.hello, now_us)
            elif isinstance(event, ev.Closed):
                self.ending = event
                if event.code == "bye" and self.streamer is not None:
                    self.streamer.said_goodbye(now_us)
            elif self.streamer is not None:
                if isinstance(event, ev.PosesReceived):
                    self._enforce(self._quota.poses(len(event.samples), now_us), now_us)
                self.streamer.on_event(event, now_us)
                if isinstance(event, ev.Acknowledged):
                    self.session.rate_hint_bps = self._link.allowance_bps(now_us)
                elif isinstance(event, ev.ControlReceived) and event.control.action == "seek":
                    self.session.cancel(lambda each: not isinstance(each.message, Blob), now_us=now_us)
                self._queue_marks(self.streamer, now_us)

    def _enforce(self, broken: str | None, now_us: int) -> None:
        if broken is not None:
            self.session.refuse(RefusalCode.QUOTA, broken, f"too many {broken} a second; send less", now_us=now_us)

    def _join(self, hello: Hello, now_us: int) -> None:
        refusal = self._admit(hello) if self._admit else None
        if refusal is not None:
            self.session.refuse(*refusal, now_us=now_us)
            return
        fault = undrawable(hello.intrinsics, full_size=self._settings.reference_full_size)
        if fault is not None:
            self.session.refuse(RefusalCode.MALFORMED, "intrinsics", fault, now_us=now_us)
            return
        resumed = hello.resume.startswith(f"{self._library.digest}-")
        try:
            inventory = unpack_inventory(hello.inventory) if resumed else ()
        except ProtocolError as error:
            self.session.refuse(RefusalCode.MALFORMED, "inventory", str(error), now_us=now_us)
            return
        streamer = Streamer(
            self._library,
            self._settings,
            hello,
            link=self._link,
            may_render=self._may_render,
            lightly=self._lightly,
            fetches=self._fetches,
        )
        if resumed:
            streamer.resume(inventory)
        self.streamer = streamer
        self.session.rate_hint_bps = self._link.allowance_bps(now_us)
        # Any server of this bundle can take a session over: its name says of which bundle the client holds tiles.
        session = f"{self._library.digest}-{self.name}"
        self.session.accept(streamer.welcome(session, resumed=resumed), now_us=now_us)
        self._open(streamer, now_us)

    def _open(self, streamer: Streamer, now_us: int) -> None:
        """The first picture, as soon as it is there to be sent."""
        self._unopened = True
        if self._needed() is None:
            self._unopened = False
            self._queue(streamer.startup(now_us), now_us)

    def _recall(self, streamer: Streamer, now_us: int) -> None:
        """Take back messages whose frame has been displayed, before the next tiles are chosen."""
        self.session.cancel(lambda each: streamer.outdated(each, now_us), now_us=now_us, started=False)
        self._settle(now_us)
        self._queue(streamer.take_late_ends(now_us), now_us)

    def _queue_marks(self, streamer: Streamer, now_us: int) -> None:
        for mark in streamer.take_marks():
            self.session.queue(mark, now_us=now_us)

    def _queue(self, outgoing: Iterable[ev.Outgoing], now_us: int) -> None:
        for each in outgoing:
            self.session.queue(each, now_us=now_us)
