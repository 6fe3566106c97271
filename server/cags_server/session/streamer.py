"""The server's core for one client: from poses, acknowledgements and controls to planned frames and messages.

Pure: no clock, no socket, no task. The owner passes ``now_us`` (server clock), hands in session events, runs the
:class:`~cags_server.reference.FrameJob` that :meth:`Streamer.begin` gives wherever it likes, and queues what
:meth:`Streamer.finish` returns. Real time and virtual time run this same code.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

from cags_common.geometry import Camera, Pose
from cags_common.poses import Focus
from cags_common.tiles.inventory import InventoryEntry
from cags_protocol import events as ev
from cags_protocol.timeline import Timeline
from cags_protocol.wire.messages import (
    Control,
    FrameEnd,
    Hello,
    Mark,
    ReferenceFrame,
    ReferenceKind,
    TileLayers,
    Welcome,
)
from cags_server.fov import widened
from cags_server.link import LinkState
from cags_server.link.byte_budget import ByteBudget
from cags_server.link.pace import MARGIN_US
from cags_server.link.reference_budget import REFERENCE_OVERHEAD_BYTES, ReferenceBudget
from cags_server.records import Ahead, FrameRecord, ReferenceCosts, StreamStats
from cags_server.reference.coder import ReferenceCoder
from cags_server.reference.job import FrameJob, FramePlan, FrameRender
from cags_server.reference.mirror import Mirror
from cags_server.reference.video import ReferenceVideo
from cags_server.reference.worth import Worth
from cags_server.scene.library import SceneLibrary
from cags_server.scene.visible_tiles import VisibleTile
from cags_server.session.dispatch import Dispatch
from cags_server.session.frame_arrivals import FrameArrivals
from cags_server.session.schedule import Schedule
from cags_server.session.startup import Startup
from cags_server.session.tile_planner import FEW_PASSED, TilePlanner
from cags_server.session.tile_sender import TileSender
from cags_server.session.viewer import Viewer
from cags_server.settings import PLAIN, ServerSettings
from cags_server.visibility.visibility import Visibility

MARK_EVERY_US = 30_000
"""Longest time that anything sent waits for a mark: clients show nothing that came after the newest one."""

LOOK_EVERY = 3
"""Frames between renders without a reference, which only determine the visible splats."""

REFERENCE_WORK = 6
"""Cost of a reference relative to a render for visibility: four times the pixels, a second render of the mirror, and
coding.
"""

OVERLOAD = 1.5
"""Largest time to make a reference, in intervals between references; beyond it references become rare."""


GREETING_DEADLINE_US = 2_000_000
"""Time after which a first picture is useless, because tiles have arrived."""

GOODBYE_SOONER_US = 50_000
"""By how much sooner than the last pose a goodbye may be read after it was sent: a busy server reads both at once."""

GREETING_AGAIN_US = 20_000
"""Interval between attempts at a first picture while the renderer has no free slot."""


class Streamer:
    """Decides what is sent to one client."""

    def __init__(
        self,
        library: SceneLibrary,
        settings: ServerSettings,
        hello: Hello,
        *,
        link: LinkState,
        may_render: Callable[[int], bool] = lambda now_us: True,
        lightly: Callable[[], bool] = lambda: False,
        fetches: bool = False,
    ) -> None:
        """``may_render(now_us)`` says whether the renderer has a slot for this client when a reference is due.
        ``lightly()`` says whether references should save processor time. ``fetches``: the owner reads what
        :attr:`next_frames` and :attr:`next_opening` name; else what is needed is read where it is needed.
        """
        self.stats = StreamStats(levels=library.manifest.lods)
        self.lacking: float | None = None
        """Mean squared error, RGB in [0, 1], of the client's picture at the newest reference; None if unknown."""
        self._library, self._settings, self._hello = library, settings, hello
        self._link, self._may_render, self._lightly = link, may_render, lightly
        self._viewer = Viewer(settings, hello)
        manifest = library.manifest
        focus = Focus(manifest.focus_centre, manifest.focus_radius)
        self._coder = ReferenceCoder(settings, hello, manifest.fps, focus)
        self._mirror = Mirror(library, settings.render_threads)
        self._tiles = TileSender(library, opening=settings.opening_tiles)
        start = min(hello.start_frame, library.manifest.frames - 1)
        timeline = Timeline(library.manifest.fps, library.manifest.frames, frame=start)
        self._schedule = Schedule(settings, timeline, self._viewer.clock, link)
        self._startup = Startup(library, self._tiles)
        self._video = ReferenceVideo()
        self._reference_budget = ReferenceBudget(link, settings.reference_most)
        self._worth = Worth()
        self._visibility = Visibility(library, settings.visible_px)
        arrivals = FrameArrivals(self.stats, self._viewer.clock, library.gof_start)
        self._dispatch = Dispatch(ByteBudget(link, settings.queue_ms), arrivals, self.stats)
        self._planner = TilePlanner(
            library,
            settings,
            viewer=self._viewer,
            schedule=self._schedule,
            link=link,
            visibility=self._visibility,
            tiles=self._tiles,
            dispatch=self._dispatch,
            worth=self._worth,
            fetches=fetches,
        )
        self._rests_until_us = 0  # the renderer, after a job that took long
        self._render_plan: FramePlan | None = None  # the newest
        self._went_ahead: FrameRecord | None = None  # what was sent for the pending render
        self._marks: list[ev.Outgoing] = []
        self._joined_us = self._marked_us = 0
        self._unmarked = False  # whether anything was sent since the newest mark
        self._restarted = False  # the client was told to forget everything
        self._under_way: set[ev.Outgoing] = set()  # tiles that were written, and have not arrived
        self._forgotten: set[ev.Outgoing] = set()  # those written before the client was told to forget them
        self._greeting_due_us: int | None = None  # of the first picture, before the viewer starts playback
        self._damaged = False  # a sent message did not arrive completely
        self._no_place = False  # at the renderer, for the frame that is due
        self._last_pose: tuple[int, int] | None = None  # its time by the client's clock, and when it arrived

    # ------------------------------------------------------------------------------------------------------- startup

    def welcome(self, session: str, *, resumed: bool = False) -> Welcome:
        """The answer to the client's Hello."""
        manifest = self._library.manifest
        return Welcome(session, manifest.fps, manifest.frames, resumed, manifest.public_json())

    def startup(self, now_us: int) -> list[ev.Outgoing]:
        """The first messages of a client (:class:`~cags_server.session.startup.Startup`), enough to begin playback."""
        camera = self._viewer.camera(self._hello.pose)
        self._greeting_due_us, self._joined_us = None if self._startup.resumed else now_us, now_us
        return self._dispatch.queue(self._startup.messages(self._schedule.timeline.frame, camera, now_us), now_us)

    @property
    def first_frame(self) -> int:
        """The media frame that :meth:`startup` begins with."""
        return self._schedule.timeline.frame

    @property
    def next_frames(self) -> tuple[int, ...]:
        """The media frames whose tiles the next plan chooses; none at the end."""
        ahead = self._frame_ahead
        if ahead is None:
            return ()
        ended = ahead if self._tiles.ended is None else self._tiles.ended
        passed = range(ended + 1, ahead) if ahead - ended - 1 <= FEW_PASSED else ()
        return (*passed, ahead)

    @property
    def next_opening(self) -> int | None:
        """The first frame of the next group, if plans could use it and it is not read yet; they do not wait for it."""
        return self._planner.to_fetch

    @property
    def _frame_ahead(self) -> int | None:
        """The next media frame to plan tiles for; None for none."""
        frame = self._schedule.next_frame
        return None if frame is None else self._ahead(self._schedule.serves, frame).frame

    @property
    def wait_us(self) -> float:
        """Longest time that a reference may wait for the renderer before its frame is sent without one."""
        return self._schedule.grace_us()

    def startup_due_us(self) -> int | None:
        """The time to call :meth:`end_startup`."""
        return self._startup.due_us()

    def end_startup(self, now_us: int) -> list[ev.Outgoing]:
        """The end of the first frame while the link is still busy with it, so that playback can begin."""
        return self._dispatch.queue(self._startup.end(now_us), now_us)

    def resume(self, inventory: Iterable[InventoryEntry]) -> None:
        """The client still holds these tiles, and the codebooks, from an earlier session: they are not sent again."""
        held = tuple(inventory)
        self._startup.resumed = True
        self._tiles.resume(held)
        self._mirror.resume(held)

    # -------------------------------------------------------------------------------------------------------- events

    def on_event(self, event: ev.ServerEvent, now_us: int) -> None:
        """Take one event of the session."""
        match event:
            case ev.PosesReceived(samples, arrival_us, cadence_permille):
                self._viewer.observe(samples, arrival_us)
                self._schedule.cadence_permille = cadence_permille
                self._schedule.follow_clock(arrival_us)
                if samples:
                    self._last_pose = samples[-1].t_us, arrival_us
                    self._dispatch.arrivals.displayed(self._schedule.timeline, samples[-1].t_us, cadence_permille)
            case ev.Acknowledged(sample):
                self._link.on_ack(sample)
                self.stats.rtt_us, self.stats.bandwidth_bps = sample.rtt_us, self._link.estimate_bps(now_us)
            case ev.ControlReceived(control, arrival_us):
                self._on_control(control, arrival_us)
            case ev.KeyframeRequested(reference_seq):
                self._video.requested(reference_seq)
            case ev.Sent(outgoing, _):
                self._on_sent(outgoing, now_us)
            case ev.Delivered(outgoing, _):
                self._on_settled(outgoing, delivered=True)
                self._on_arrived(outgoing, now_us)
            case ev.Dropped(outgoing, reason, sent_bytes, _):
                self.stats.bytes_dropped += sent_bytes
                self._on_settled(outgoing, delivered=False)
                self._damaged |= reason == "lost" and isinstance(outgoing.message, TileLayers | FrameEnd)
                display_us = self._left(outgoing)
                if reason == "cancelled" and display_us is not None and display_us <= self._late_until_us(now_us):
                    self._dispatch.ends.taken_back(outgoing, display_us)
            case ev.Evicted(tiles):
                for held in tiles:
                    self._tiles.evicted(held)
            case _:
                pass

    def said_goodbye(self, now_us: int) -> None:
        """The client has left: what was due since its last pose was due, too. Its goodbye waited on the way about as
        long as that pose, whatever else waits there.
        """
        if self._last_pose is not None:
            t_us, arrival_us = self._last_pose
            until_us = min(self._viewer.clock.to_client(now_us), t_us + now_us - arrival_us + GOODBYE_SOONER_US)
            self._dispatch.arrivals.displayed(self._schedule.timeline, until_us, self._schedule.cadence_permille)

    def _on_sent(self, outgoing: ev.Outgoing, now_us: int) -> None:
        """A message was written completely."""
        self._dispatch.sent(outgoing)
        self._left(outgoing)
        if isinstance(outgoing.message, TileLayers):
            self._under_way.add(outgoing)
        if isinstance(outgoing.message, TileLayers | FrameEnd):
            if self._coder.may_compare:
                self._mirror.sent(outgoing.message, outgoing.payload)
            self._unmarked = True
            self.mark_if_due(now_us)

    def _left(self, outgoing: ev.Outgoing) -> int | None:
        """A message has left the queue; returns the display of the frame that it ends, by the client's clock."""
        message = outgoing.message
        if isinstance(message, ReferenceFrame):
            self._reference_budget.left(message.frame)
        return self._dispatch.ends.left(message.frame) if isinstance(message, FrameEnd) else None

    def _on_control(self, control: Control, now_us: int) -> None:
        self._schedule.controlled(control, now_us)
        self._dispatch.arrivals.restart()
        self._went_ahead = None
        self._planner.restart(goes_on=control.action != "seek")
        self._dispatch.ends.clear()
        self._tiles.client_keeps = control.keeps
        frame = self._schedule.timeline.frame  # within the clip
        if control.action != "seek":
            self._tiles.go_on(frame)
            return
        self._tiles.jump(frame)
        self._tiles.from_nothing = True
        self._video.broken()
        self._restart_if_forgotten(frame, now_us)

    def _restart_if_forgotten(self, frame: int, now_us: int) -> None:
        """The client must discard everything: tell it, and reset the mirror."""
        if self._tiles.forgotten:
            self._tiles.forgotten = False
            self._mirror.restart(frame)
            self._dispatch.arrivals.forget()
            self._forgotten |= self._under_way
            # Once there was a mark, clients show nothing that came after the newest, and no reference will bring one
            # to those without.
            self._restarted = True
            self._mark(now_us, restart=True)

    def _mark(self, now_us: int, *, restart: bool = False) -> int:
        """Record the messages before the next one, which form the basis of references."""
        number, self._marked_us, self._unmarked = self._mirror.mark(), now_us, False
        self._marks.append(ev.Outgoing(Mark(number, restart)))
        return number

    @property
    def mark_due_us(self) -> int | None:
        """Time of the next mark beside those of references; None while nothing waits for one. A client that has had no
        mark needs none.
        """
        if not self._unmarked or (self._coder.kind is None and not self._restarted):
            return None
        return self._marked_us + (0 if self._coder.kind is None else MARK_EVERY_US)

    def mark_if_due(self, now_us: int) -> None:
        """Mark what was sent, where no later message will."""
        due_us = self.mark_due_us
        if due_us is not None and now_us >= due_us:
            self._mark(now_us)

    def take_marks(self) -> list[ev.Outgoing]:
        """Marks to queue at once: no message may be completed before them."""
        marks, self._marks = self._marks, []
        return marks

    def _on_settled(self, outgoing: ev.Outgoing, *, delivered: bool) -> None:
        message = outgoing.message
        if isinstance(message, Mark):  # not counted in the plan, because marks are tiny
            return
        self._dispatch.budget.settled(outgoing)
        if isinstance(message, TileLayers):
            self._under_way.discard(outgoing)
            if outgoing in self._forgotten:
                self._forgotten.discard(outgoing)
            else:
                self._tiles.settled(message, delivered=delivered)
            self._startup.settled(message)
        elif isinstance(message, ReferenceFrame) and not delivered:
            self._video.dropped(message)

    def _on_arrived(self, outgoing: ev.Outgoing, now_us: int) -> None:
        """Tell the pace how late a reference was, and when the data of a frame was complete. The delay of an
        acknowledgement needs no correction, because poses have the same delay, and the client's clock is estimated from
        them.
        """
        if isinstance(outgoing.message, FrameEnd):
            self._dispatch.arrivals.arrived(outgoing.message.frame, now_us)
        if not (isinstance(outgoing.message, ReferenceFrame) and self._schedule.timeline.playing):
            return
        if outgoing.deadline_us is not None:
            self._schedule.pace.arrived(now_us - self._display_us(outgoing.deadline_us))

    # ------------------------------------------------------------------------------------------------------ planning

    def next_due_us(self) -> int | None:
        """Time to plan the next frame, or more tiles for the last one, by the server's clock; None for neither."""
        if self._greeting_due_us is not None:
            return self._greeting_due_us
        due_us, detail_us = self.frame_due_us(), self._planner.detail_due_us()
        return due_us if due_us is None or detail_us is None else min(due_us, detail_us)

    def frame_due_us(self) -> int | None:
        """Time to plan the next frame; None if there is none."""
        return self._schedule.next_due_us(self._next_is_seen)

    def begin(self, now_us: int) -> FrameJob | None:
        """Plan a due frame: predict the viewer's pose and choose the field of view. None if no frame is due.

        It is the newest one, or one before it that skips fewer: references of those that are skipped would be late.
        Where no references are made, the oldest one is planned.
        """
        if self._greeting_due_us is not None:
            return self._greeting(now_us) if now_us >= self._greeting_due_us else None
        if self._schedule.rendering:
            return None
        due_us = self.frame_due_us()
        if due_us is None or now_us < due_us or self._between_references(now_us):
            return None
        tick, frame, covered = self._schedule.begin_render(now_us - due_us if self._pays else 0)
        if self._damaged:
            self._damaged = False
            self._tiles.start_anew()
            self._restart_if_forgotten(frame, now_us)
        plan = self._render_plan = self._plan(tick, frame, covered, now_us)
        return self._job(plan, now_us)

    def _greeting(self, now_us: int) -> FrameJob | None:
        """The first picture for a client that has just joined, sent before the first tile.

        While the renderer has no free slot, it is retried until the viewer starts playback.
        """
        self._greeting_due_us = None
        affordable = self._reference_budget.bears(now_us, GREETING_DEADLINE_US)
        if self._coder.kind is None or self._schedule.begun or not affordable:
            return None
        if not self._may_render(now_us):
            again_us = now_us + GREETING_AGAIN_US
            self._greeting_due_us = again_us if again_us < self._joined_us + GREETING_DEADLINE_US else None
            return None
        self._schedule.rendering = True
        frame, seen = self._schedule.timeline.frame, self._viewer.first_view()
        plan = FramePlan(
            generation=self._schedule.generation,
            tick=0,
            frame=frame,
            ahead=Ahead(frame, 0),
            before=(),
            ticks_covered=1,
            skipped=0,
            planned_us=now_us,
            display_us=0,
            horizon_us=0,
            predicted=seen,
            margins=self._viewer.margins(frame, seen),
            light=self._lightly(),
            speaks=True,
            idr=self._video.needs_idr,
            basis=self._mark(now_us),
            greets=True,
        )
        return self._job(plan, now_us)

    def _job(self, plan: FramePlan, now_us: int) -> FrameJob:
        if plan.speaks:
            self._coder.follow(self._link.estimate_bps(now_us), self._schedule.reference_period_us)
        size = self._coder.width_px, self._coder.height_px
        intrinsics = widened(self._hello.intrinsics, plan.margins, *size)
        return FrameJob(
            plan=plan,
            library=self._library,
            mirror=self._mirror if self._coder.may_compare else None,
            compares=plan.speaks and self._coder.compares,
            camera=Camera(intrinsics, plan.predicted.pose, self._hello.near),
            client=self._hello.intrinsics,
            coder=self._coder,
            visible_px=self._settings.visible_px,
            threads=self._settings.render_threads,
            stale=self._visibility.stale,
            plain_footprint=self._settings.reference_footprint == PLAIN,
        )

    def catch_up(self, now_us: int) -> list[ev.Outgoing]:
        """Tiles and ends of frames between two references, or while a job takes long, by the last known visibility.

        Only references wait for the renderer; media does not. Before the first render, visibility follows from tile
        bounds.
        """
        due_us = self.frame_due_us()
        if due_us is None:
            return []
        if now_us < due_us:
            return self._planner.more_detail(now_us)
        between = self._between_references(now_us)
        if not (self._schedule.rendering or between):
            return []
        seen = self._next_is_seen()
        slow = self._is_slow(now_us)
        tick, covered = self._schedule.go_blind(now_us - due_us, slow=slow)
        plan = self._blind_plan(tick, covered, now_us)
        record = self._record(plan)
        if self._schedule.is_out(tick):
            self._went_ahead = record  # of the pending render, whose reference is not late yet
        else:
            record.reference_late = not between
            record.no_place = between and (self._no_place or self._given_up)
            self.stats.references_late += record.reference_late
        ahead = plan.ahead.frame
        self._enter(ahead, now_us)
        told = seen and self._visibility.tells_of(ahead)
        visible = self._visibility.tiles(ahead) if told else self._tiles_in_view(ahead, plan.predicted.pose)
        out = self._planner.beginning(plan, now_us)
        if not slow:  # what passed frames began is in force in the one ahead, or of no use by then
            out += self._planner.passed_over(plan, record, now_us)
        return out + self._planner.frame(visible, record, now_us)

    def _enter(self, frame: int, now_us: int) -> None:
        self._tiles.enter(frame)
        self._restart_if_forgotten(frame, now_us)

    def _blind_plan(self, tick: int, ticks_covered: int, now_us: int) -> FramePlan:
        """The plan for a frame without a render, or the plan of the pending render."""
        if self._render_plan is not None and self._schedule.is_out(tick):
            return self._render_plan
        frame = self._schedule.media_frame(tick)
        assert frame is not None, "no tick after the end is served"
        return self._plan(tick, frame, ticks_covered, now_us, drawn=False)

    def _ahead(self, tick: int, frame: int) -> Ahead:
        """The frame whose tiles go out with the reference of ``tick``; ``frame`` again at the clip's end."""
        return self._at(self._schedule.ahead(tick), frame)

    def _at(self, tick: int, frame: int) -> Ahead:
        """The frame of ``tick``, and when it is displayed; ``frame`` where the clip has ended."""
        then = self._schedule.media_frame(tick)
        return Ahead(frame if then is None else then, self._schedule.timeline.display_us(tick))

    def _tiles_in_view(self, frame: int, pose: Pose) -> tuple[VisibleTile, ...]:
        camera = self._viewer.camera(pose)
        return self._visibility.guessed_tiles(frame, camera, self._coder.width_px * self._coder.height_px)

    def _between_references(self, now_us: int) -> bool:
        """Whether the due frame gets no reference, by the settings or because link or renderer cannot afford it."""
        seen = self._next_is_seen()
        spare_us = self._reference_deadline_us(self._schedule.timeline.display_us(self._schedule.next_tick)) - now_us
        affordable = self._reference_budget.bears(now_us, spare_us)
        room = affordable and now_us >= self._rests_until_us and not self._is_behind(now_us)
        if seen and not self._schedule.rendering:
            self._no_place = room and not self._may_render(now_us)
            if not room or self._no_place:
                return True
        if not self._pays:
            return self._schedule.between_renders(LOOK_EVERY, seen=seen)
        return not self._video.urgent and self._schedule.between_renders(self._settings.reference_every, seen=seen)

    @property
    def _given_up(self) -> bool:
        """Whether no references are made because this machine is too slow for them."""
        return self._coder.kind is not None and not self._pays

    @property
    def _pays(self) -> bool:
        """Whether frames get references now."""
        if self._coder.kind is None:
            return False
        return self._settings.references != "auto" or self._worth.pays

    def _next_is_seen(self) -> bool:
        """Whether the last visibility is valid for the next tiles; it is not in another group of frames."""
        ahead = self._frame_ahead
        if ahead is None or self._tiles.ended is None or ahead < self._tiles.ended:
            return False
        return self._visibility.tells_of(ahead)

    def _plan(self, tick: int, frame: int, ticks_covered: int, now_us: int, *, drawn: bool = True) -> FramePlan:
        """The plan for a frame, with a reference render if ``drawn``."""
        display_us = self._schedule.timeline.display_us(tick)
        self._viewer.ensure_pose(now_us)
        predicted = self._viewer.predict(display_us)
        speaks = drawn and self._pays
        return FramePlan(
            generation=self._schedule.generation,
            tick=tick,
            frame=frame,
            ahead=self._ahead(tick, frame),
            before=tuple(self._at(between, frame) for between in self._schedule.between),
            ticks_covered=ticks_covered,
            skipped=self._schedule.planned(now_us),
            planned_us=now_us,
            display_us=display_us,
            horizon_us=self._viewer.horizon_us(display_us) if drawn else 0,
            predicted=predicted,
            margins=self._viewer.margins(frame, predicted) if drawn else (0.0, 0.0),
            light=self._lightly(),
            speaks=speaks,
            idr=speaks and self._video.needs_idr,
            basis=self._mark(now_us) if drawn and self._coder.kind is not None else 0,
        )

    # ----------------------------------------------------------------------------------------------------- finishing

    def abandon(self, job: FrameJob) -> None:
        """A job failed or was cancelled: its picture does not exist."""
        self._schedule.rendering = False
        self._video.broken()

    def finish(self, render: FrameRender, now_us: int) -> list[ev.Outgoing]:
        """Turn a finished job into messages: the reference, the tiles that the rate policy chose, the frame's end."""
        plan = render.plan
        self._schedule.rendering = False
        work_us = now_us - plan.planned_us
        self._schedule.pace.observe(work_us, len(render.coded.access_unit), now_us)
        more_us = 0.0 if plan.speaks else (REFERENCE_WORK - 1) * min(render.took_us, work_us)
        whole_us = work_us + more_us
        self._worth.made(slowly=whole_us > OVERLOAD * self._schedule.reference_period_us)
        # A job longer than a frame starves everything else on the machine: tiles, and a client beside the server.
        self._rests_until_us = now_us + max(work_us - round(self._schedule.reference_period_us), 0)
        self.stats.references += plan.speaks
        self.stats.mirror_bytes = self._mirror.memory_bytes
        if plan.speaks:
            self.lacking = render.coded.before
            self._schedule.client_lacks(self.lacking)
            cost = ReferenceCosts(1, render.render_ns + render.mirror_ns, render.encode_ns)
            if plan.light:
                self.stats.light += cost
            else:
                self.stats.careful += cost
        if plan.generation != self._schedule.generation:  # the viewer seeked meanwhile
            self._video.broken()
            return []
        if plan.greets:
            self._reference_budget.spent(plan.frame, len(render.coded.access_unit) + REFERENCE_OVERHEAD_BYTES)
            return self._dispatch.queue([self._video.message(render, now_us + GREETING_DEADLINE_US)], now_us)
        self._visibility.rendered(plan.ahead.frame, render.contribution, self._viewer.camera(plan.predicted.pose))
        overtaken = self._schedule.overtaken(plan.tick)
        if not overtaken:
            self._enter(plan.ahead.frame, now_us)
        ahead, self._went_ahead = self._went_ahead, None
        record = ahead if ahead is not None and ahead.tick == plan.tick else self._record(plan)
        record.reference_late = now_us >= self._viewer.clock.to_server(plan.display_us)
        self.stats.references_late += record.reference_late
        out = self._dispatch.queue(self._reference_if_useful(render, record, now_us), now_us)
        if overtaken:  # its tiles, and later ones, were sent before it
            return out
        out += self._planner.beginning(plan, now_us)
        if not self._is_slow(now_us):
            out += self._planner.passed_over(plan, record, now_us)
        out += self._planner.frame(render.visible, record, now_us)
        self._visibility.served(plan.ahead.frame, render.contribution, self._tiles.inventory)
        return out

    def _reference_if_useful(self, render: FrameRender, record: FrameRecord, now_us: int) -> list[ev.Outgoing]:
        """The reference, unless it is too late to be useful; then the next one must be an IDR picture."""
        if not render.plan.speaks:
            return self._moving_on(render)
        slow = now_us - render.plan.planned_us > OVERLOAD * self._schedule.reference_period_us
        if now_us >= self._reference_deadline_us(render.plan.display_us):
            self._video.broken()
            self._worth.came(now_us, in_vain=slow)
            return []
        coded = render.coded
        record.reference_bytes, record.reference_kind = len(coded.access_unit), coded.kind.value
        record.lacking, record.left = coded.before, coded.after
        travels_us = self._link.newest.rtt_us / 2 + self._link.through_us(len(coded.access_unit), now_us)
        late = now_us + travels_us >= self._viewer.clock.to_server(render.plan.display_us)
        self._coder.lateness.observe(late=late or slow)
        self._worth.came(now_us, in_vain=late and slow)
        self._reference_budget.spent(record.frame, record.reference_bytes + REFERENCE_OVERHEAD_BYTES)
        return [self._video.message(render, self._reference_deadline_us(render.plan.display_us))]

    def _moving_on(self, render: FrameRender) -> list[ev.Outgoing]:
        """An empty reference, sent when references are no longer made. Without it, a client would keep showing the last
        one, and, while paused, no splats beyond those that it assumes.
        """
        if self._coder.kind is None or (self._schedule.timeline.playing and self._video.silent):
            return []
        return [self._video.message(render, self._reference_deadline_us(render.plan.display_us))]

    def _record(self, plan: FramePlan) -> FrameRecord:
        record = FrameRecord(
            tick=plan.tick,
            frame=plan.frame,
            ahead=plan.ahead,
            planned_us=plan.planned_us,
            display_us=plan.display_us,
            horizon_us=plan.horizon_us,
            predicted=plan.predicted.pose,
            margins=plan.margins,
            ticks_covered=plan.ticks_covered,
            skipped=plan.skipped,
        )
        self.stats.records.append(record)
        self.stats.frames += 1
        self.stats.frames_skipped += plan.skipped
        self._viewer.expect(record)
        return record

    # ------------------------------------------------------------------------------------------------------ messages

    def outdated(self, outgoing: ev.Outgoing, now_us: int) -> bool:
        """Whether a waiting tile is for a frame that has been displayed, or the end of a frame would be late: another
        tile may be worth more now, and for ends see :meth:`take_late_ends`.
        """
        message, deadline_us = outgoing.message, outgoing.deadline_us
        if isinstance(message, FrameEnd):
            return self._dispatch.ends.has(message.frame, self._late_until_us(now_us))
        if not isinstance(message, TileLayers) or deadline_us is None:
            return False
        return now_us >= deadline_us - int(self._settings.tile_deadline_ms * 1000)

    def _late_until_us(self, now_us: int) -> int:
        """Displays, by the client's clock, up to which an end comes too late if it waits for another planned frame."""
        newest = self._link.newest
        travels_us = newest.shortest_rtt_us / 2 + self._link.through_us(newest.in_flight_bytes, now_us)
        return self._viewer.clock.to_client(now_us + round(travels_us + self._schedule.planned_period_us) + MARGIN_US)

    @property
    def _sends_anew(self) -> bool:
        """Whether changed splats are sent again in every frame, because the bundle has no motion."""
        return self._library.manifest.motion is None

    def _is_slow(self, now_us: int) -> bool:
        """Whether this machine does not keep up with planning."""
        due_us = self.frame_due_us()
        return due_us is not None and self._schedule.is_slow(now_us - due_us, now_us)

    def _is_behind(self, now_us: int) -> bool:
        """Whether the next reference is of no use because the client shows an older frame.

        A difference assumes what was sent before it, and the client shows no more than that: the end of its frame must
        be out. A picture assumes nothing, so it is of use until the client stands still. Where splats are sent anew for
        every frame, an older frame with its difference is better than a newer one without its splats.
        """
        if self._coder.kind is ReferenceKind.DIFFERENCE and not self._sends_anew:
            return self._dispatch.ends.any_until(self._schedule.timeline.display_us(self._schedule.next_tick))
        return self._dispatch.ends.any_until(self._viewer.clock.to_client(now_us))

    def take_late_ends(self, now_us: int) -> list[ev.Outgoing]:
        """Frame ends that would be late where they wait, to queue again ahead of all else."""
        return self._dispatch.queue_again(now_us)

    def _display_us(self, deadline_us: int) -> int:
        """Display time of the frame of a reference that is useful until ``deadline_us``; both by the server's clock."""
        return deadline_us - int(self._settings.reference_deadline_ms * 1000)

    def _reference_deadline_us(self, display_us: int) -> int:
        """A late reference is still useful for the frames after its own."""
        return self._viewer.clock.to_server(display_us) + int(self._settings.reference_deadline_ms * 1000)
