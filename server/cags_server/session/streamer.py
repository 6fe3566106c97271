"""The server's core for one client: from poses, acknowledgements and controls to planned frames and messages.

Pure: no clock, no socket, no task. The owner passes ``now_us`` (server clock), hands in session events, runs the
:class:`~cags_server.reference.FrameJob` that :meth:`Streamer.begin` gives wherever it likes, and queues what
:meth:`Streamer.finish` returns. Real time and virtual time run this same code.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace

from cags_common.geometry import Camera, Pose
from cags_common.tiles.inventory import InventoryEntry
from cags_common.tiles.kinds import TileKind
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
from cags_server.link.byte_budget import MESSAGE_OVERHEAD_BYTES, ByteBudget
from cags_server.link.pace import MARGIN_US
from cags_server.link.reference_budget import REFERENCE_OVERHEAD_BYTES, ReferenceBudget
from cags_server.ratecontrol import Decision, Observation, create_rate_policy
from cags_server.ratecontrol.base import mean_level
from cags_server.ratecontrol.outlook import Supply, lacking_bytes, supply
from cags_server.records import Ahead, FrameRecord, ReferenceCosts, StreamStats
from cags_server.reference.coder import ReferenceCoder
from cags_server.reference.job import FrameJob, FramePlan, FrameRender
from cags_server.reference.mirror import Mirror
from cags_server.reference.video import ReferenceVideo
from cags_server.reference.worth import Worth
from cags_server.scene.library import SceneLibrary
from cags_server.scene.visible_tiles import VisibleTile
from cags_server.session.frame_arrivals import FrameArrivals
from cags_server.session.schedule import Schedule
from cags_server.session.startup import Startup
from cags_server.session.tile_sender import TileSender
from cags_server.session.viewer import Viewer
from cags_server.session.waiting_ends import WaitingEnds
from cags_server.settings import PLAIN, ServerSettings
from cags_server.visibility.visibility import Visibility

MARK_EVERY_US = 30_000
"""Longest interval between marks while tiles are being sent: clients show nothing after the newest mark."""

LOOK_EVERY = 3
"""Frames between renders without a reference, which only determine the visible splats."""

REFERENCE_WORK = 6
"""Cost of a reference relative to a render for visibility: four times the pixels, a second render of the mirror, and
coding.
"""

OVERLOAD = 1.5
"""Largest time to make a reference, in intervals between references; beyond it references become rare."""

FEW_PASSED = 2
"""Largest number of passed frames that are planned by themselves in a bundle with motion: single attributes may change
in every frame.
"""

RESERVED_SPLATS = 1 << 20
"""Largest number of splats that appear within the reserve: the client holds them decoded, up to 240 bytes each."""

LOOK_BACK_EVERY = 4
"""Planned frames until what the reserve has passed over is looked for again; every frame where splats are sent whole.
"""

GREETING_DEADLINE_US = 2_000_000
"""Time after which a first picture is useless, because tiles have arrived."""

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
    ) -> None:
        """``may_render(now_us)`` says whether the renderer has a slot for this client when a reference is due.
        ``lightly()`` says whether references should save processor time.
        """
        self.stats = StreamStats(levels=library.manifest.lods)
        self.lacking: float | None = None
        """Mean squared error, RGB in [0, 1], of the client's picture at the newest reference; None if unknown."""
        self._library, self._settings, self._hello = library, settings, hello
        self._link, self._may_render, self._lightly = link, may_render, lightly
        self._viewer = Viewer(settings, hello)
        self._policy = create_rate_policy(settings.abr)
        self._coder = ReferenceCoder(settings, hello, library.manifest.fps)
        self._mirror = Mirror(library, settings.render_threads)
        self._tiles = TileSender(library, opening=settings.opening_tiles)
        start = min(hello.start_frame, library.manifest.frames - 1)
        timeline = Timeline(library.manifest.fps, library.manifest.frames, frame=start)
        self._schedule = Schedule(settings, timeline, self._viewer.clock, link)
        self._budget = ByteBudget(link, settings.queue_ms)
        self._startup = Startup(library, self._tiles)
        self._video = ReferenceVideo()
        self._reference_budget = ReferenceBudget(link, settings.reference_most)
        self._worth = Worth()
        self._visibility = Visibility(library, settings.visible_px)
        self._arrivals = FrameArrivals(self.stats, self._viewer.clock, library.gof_start)
        self._rests_until_us = 0  # the renderer, after a job that took long
        self._render_plan: FramePlan | None = None  # the newest
        self._went_ahead: FrameRecord | None = None  # what was sent for the pending render
        self._newest: FrameRecord | None = None  # the frame that was served last, while the client lacks some of it
        self._decided_us = 0  # when tiles were chosen last
        self._held_is_good = False  # the frame that the viewer is paused at, about as good as it will be
        self._followers: tuple[VisibleTile, ...] | None = None  # what begins after it and was not sent; None: not known
        self._marks: list[ev.Outgoing] = []
        self._ends = WaitingEnds()
        self._joined_us = self._marked_us = 0
        self._greeting_due_us: int | None = None  # of the first picture, before the viewer starts playback
        self._damaged = False  # a sent message did not arrive completely
        self._no_place = False  # at the renderer, for the frame that is due

    # ------------------------------------------------------------------------------------------------------- startup

    def welcome(self, session: str, *, resumed: bool = False) -> Welcome:
        """The answer to the client's Hello."""
        manifest = self._library.manifest
        return Welcome(session, manifest.fps, manifest.frames, resumed, manifest.public_json())

    def startup(self, now_us: int) -> list[ev.Outgoing]:
        """The first messages of a client (:class:`~cags_server.session.startup.Startup`), enough to begin playback."""
        camera = Camera(self._hello.intrinsics, self._hello.pose, self._hello.near)
        self._greeting_due_us, self._joined_us = None if self._startup.resumed else now_us, now_us
        return self._counted(self._startup.messages(self._schedule.timeline.frame, camera, now_us), now_us)

    @property
    def first_frame(self) -> int:
        """The media frame that :meth:`startup` begins with."""
        return self._schedule.timeline.frame

    @property
    def next_frames(self) -> tuple[int, ...]:
        """The media frames that the next plan looks at: its own, and those that it plans tiles for; none at the end."""
        own, ahead = self._schedule.next_frame, self._frame_ahead
        if own is None or ahead is None:
            return ()
        ended = ahead if self._tiles.ended is None else self._tiles.ended
        passed = range(ended + 1, ahead) if ahead - ended - 1 <= FEW_PASSED else ()
        return (own, *passed, ahead)

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
        return self._counted(self._startup.end(now_us), now_us)

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
                    self._arrivals.displayed(self._schedule.timeline, samples[-1].t_us, cadence_permille)
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
                    self._ends.taken_back(outgoing, display_us)
            case ev.Evicted(tiles):
                for held in tiles:
                    self._tiles.evicted(held)
            case _:
                pass

    def _on_sent(self, outgoing: ev.Outgoing, now_us: int) -> None:
        """A message was written completely."""
        self._left(outgoing)
        if isinstance(outgoing.message, TileLayers | FrameEnd):
            if self._coder.compares:
                self._mirror.sent(outgoing.message, outgoing.payload)
            if now_us - self._marked_us >= MARK_EVERY_US and self._coder.kind is not None:
                self._mark(now_us)

    def _left(self, outgoing: ev.Outgoing) -> int | None:
        """A message has left the queue; returns the display of the frame that it ends, by the client's clock."""
        message = outgoing.message
        if isinstance(message, ReferenceFrame):
            self._reference_budget.left(message.frame)
        return self._ends.left(message.frame) if isinstance(message, FrameEnd) else None

    def _on_control(self, control: Control, now_us: int) -> None:
        self._schedule.controlled(control, now_us)
        self._arrivals.restart()
        self._went_ahead = self._newest = self._followers = None
        self._held_is_good = False
        self._ends.clear()
        self._tiles.client_keeps = control.keeps
        if control.action == "seek":
            self._tiles.go_back(control.frame)
            self._tiles.from_nothing = True
            self._video.broken()
            self._restart_if_forgotten(control.frame, now_us)

    def _restart_if_forgotten(self, frame: int, now_us: int) -> None:
        """The client must discard everything: tell it, and reset the mirror."""
        if self._tiles.forgotten:
            self._tiles.forgotten = False
            self._mirror.restart(min(frame, self._library.manifest.frames - 1))
            self._arrivals.forget()
            self._mark(now_us, restart=True)

    def _mark(self, now_us: int, *, restart: bool = False) -> int:
        """Record the messages before the next one, which form the basis of references."""
        number, self._marked_us = self._mirror.mark(), now_us
        self._marks.append(ev.Outgoing(Mark(number, restart)))
        return number

    def take_marks(self) -> list[ev.Outgoing]:
        """Marks to queue at once: no message may be completed before them."""
        marks, self._marks = self._marks, []
        return marks

    def _on_settled(self, outgoing: ev.Outgoing, *, delivered: bool) -> None:
        message = outgoing.message
        if isinstance(message, Mark):  # not counted in the plan, because marks are tiny
            return
        self._budget.settled(outgoing)
        if isinstance(message, TileLayers):
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
            self._arrivals.arrived(outgoing.message.frame, now_us)
        if not (isinstance(outgoing.message, ReferenceFrame) and self._schedule.timeline.playing):
            return
        if outgoing.deadline_us is not None:
            self._schedule.pace.arrived(now_us - self._display_us(outgoing.deadline_us))

    # ------------------------------------------------------------------------------------------------------ planning

    def next_due_us(self) -> int | None:
        """Time to plan the next frame, or more tiles for the last one, by the server's clock; None for neither."""
        if self._greeting_due_us is not None:
            return self._greeting_due_us
        due_us, detail_us = self.frame_due_us(), self._detail_due_us()
        return due_us if due_us is None or detail_us is None else min(due_us, detail_us)

    def frame_due_us(self) -> int | None:
        """Time to plan the next frame; None if there is none."""
        return self._schedule.next_due_us(self._next_is_seen)

    def _detail_due_us(self) -> int | None:
        """Time to choose more tiles for the frame that was served last; None if it lacks none, or nobody has seen it.

        Where the lead has become shorter, the next frame is not due for longer than a frame, and the link would idle.
        """
        if self._newest is None or self._schedule.rendering or not self._visibility.tells_of(self._newest.ahead.frame):
            return None
        return self._decided_us + round(self._schedule.planned_period_us)

    def begin(self, now_us: int) -> FrameJob | None:
        """Plan the newest due frame: predict the viewer's pose and choose the field of view. None if no frame is due.

        Earlier due frames that were not begun are skipped, because their references would be late.
        """
        if self._greeting_due_us is not None:
            return self._greeting(now_us) if now_us >= self._greeting_due_us else None
        if self._schedule.rendering:
            return None
        due_us = self.frame_due_us()
        if due_us is None or now_us < due_us or self._between_references(now_us):
            return None
        tick, frame, covered = self._schedule.begin_render(now_us - due_us)
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
            self._video.needs_idr = False
            self._coder.follow(self._link.estimate_bps(now_us), self._schedule.reference_period_us)
        size = self._coder.width_px, self._coder.height_px
        intrinsics = widened(self._hello.intrinsics, plan.margins, *size)
        return FrameJob(
            plan=plan,
            library=self._library,
            mirror=self._mirror if plan.speaks and self._coder.compares else None,
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
        due_us, frame = self.frame_due_us(), self._schedule.next_frame
        if frame is None or due_us is None:
            return []
        if now_us < due_us:
            return self._more_detail(now_us)
        between = self._between_references(now_us)
        if not (self._schedule.rendering or between):
            return []
        seen = self._next_is_seen()
        tick, covered = self._schedule.go_blind(now_us - due_us)
        plan = self._blind_plan(tick, frame, covered, now_us)
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
        out = self._from_nothing(plan, now_us) + self._passed_over(plan, record, now_us)
        return out + self._upgrades(visible, record, now_us)

    def _more_detail(self, now_us: int) -> list[ev.Outgoing]:
        """Tiles for the frame that was served last, if they are due."""
        record, due_us = self._newest, self._detail_due_us()
        if record is None or due_us is None or now_us < due_us:
            return []
        step = replace(record, tile_bytes=0, reference_bytes=0, ticks_covered=1)
        out = self._upgrades(self._visibility.tiles(record.ahead.frame), step, now_us, passing=True)
        record.tile_bytes += step.tile_bytes
        record.budget_bytes += step.budget_bytes
        return out

    def _enter(self, frame: int, now_us: int) -> None:
        self._tiles.enter(frame)
        self._restart_if_forgotten(frame, now_us)

    def _blind_plan(self, tick: int, frame: int, ticks_covered: int, now_us: int) -> FramePlan:
        """The plan for a frame without a render, or the plan of the pending render."""
        if self._render_plan is not None and self._schedule.is_out(tick):
            return self._render_plan
        return self._plan(tick, frame, ticks_covered, now_us, drawn=False)

    def _ahead(self, tick: int, frame: int) -> Ahead:
        """The frame whose tiles go out with the reference of ``tick``; ``frame`` again at the clip's end."""
        return self._at(self._schedule.ahead(tick), frame)

    def _at(self, tick: int, frame: int) -> Ahead:
        """The frame of ``tick``, and when it is displayed; ``frame`` where the clip has ended."""
        then = self._schedule.media_frame(tick)
        return Ahead(frame if then is None else then, self._schedule.timeline.display_us(tick))

    def _tiles_in_view(self, frame: int, pose: Pose) -> tuple[VisibleTile, ...]:
        camera = Camera(self._hello.intrinsics, pose, self._hello.near)
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
        return not self._video.needs_idr and self._schedule.between_renders(self._settings.reference_every, seen=seen)

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
            return self._counted([self._video.message(render, now_us + GREETING_DEADLINE_US)], now_us)
        self._visibility.rendered(plan.ahead.frame, render.contribution)
        overtaken = self._schedule.overtaken(plan.tick)
        if not overtaken:
            self._enter(plan.ahead.frame, now_us)
        ahead, self._went_ahead = self._went_ahead, None
        record = ahead if ahead is not None and ahead.tick == plan.tick else self._record(plan)
        record.reference_late = now_us >= self._viewer.clock.to_server(plan.display_us)
        self.stats.references_late += record.reference_late
        out = self._counted(self._reference_if_useful(render, record, now_us), now_us)
        if overtaken:  # its tiles, and later ones, were sent before it
            return out
        out += self._from_nothing(plan, now_us) + self._passed_over(plan, record, now_us)
        out += self._upgrades(render.visible, record, now_us)
        self._visibility.served(plan.ahead.frame, render.contribution, self._tiles.inventory)
        return out

    def _from_nothing(self, plan: FramePlan, now_us: int) -> list[ev.Outgoing]:
        """The first tiles of a picture, for a client that holds nothing."""
        if not self._tiles.from_nothing:
            return []
        camera = Camera(self._hello.intrinsics, plan.predicted.pose, self._hello.near)
        return self._counted(self._tiles.beginning(plan.frame, camera), now_us)

    def _reference_if_useful(self, render: FrameRender, record: FrameRecord, now_us: int) -> list[ev.Outgoing]:
        """The reference, unless it is too late to be useful; then the next one must be an IDR picture."""
        if not render.plan.speaks:
            return self._moving_on(render)
        if now_us >= self._reference_deadline_us(render.plan.display_us):
            self._video.broken()
            return []
        coded = render.coded
        record.reference_bytes, record.reference_kind = len(coded.access_unit), coded.kind.value
        record.lacking, record.left = coded.before, coded.after
        travels_us = self._link.newest.rtt_us / 2 + self._link.through_us(len(coded.access_unit), now_us)
        late = now_us + travels_us >= self._viewer.clock.to_server(render.plan.display_us)
        rare = now_us - render.plan.planned_us > OVERLOAD * self._schedule.reference_period_us
        self._coder.lateness.observe(late=late or rare)
        self._reference_budget.spent(record.frame, record.reference_bytes + REFERENCE_OVERHEAD_BYTES)
        return [self._video.message(render, self._reference_deadline_us(render.plan.display_us))]

    def _moving_on(self, render: FrameRender) -> list[ev.Outgoing]:
        """An empty reference, sent when references are no longer made. Without it, a client would keep showing the last
        one, and, while paused, no splats beyond those that it assumes.
        """
        if self._coder.kind is None or (self._schedule.timeline.playing and self._video.silent):
            return []
        return [self._video.message(render, self._reference_deadline_us(render.plan.display_us))]

    def _passed_over(self, plan: FramePlan, record: FrameRecord, now_us: int) -> list[ev.Outgoing]:
        """Tiles and ends of the frames before the one planned ahead that no earlier plan served.

        Where they are many, as at the beginning, only in bundles that send splats anew for every frame: otherwise
        motion that comes with later frames will do.
        """
        if self._library.manifest.motion is not None and len(plan.before) > FEW_PASSED:
            return []
        out: list[ev.Outgoing] = []
        for ahead in plan.before:
            ended = -1 if self._tiles.ended is None else self._tiles.ended
            if ended < ahead.frame < plan.ahead.frame and self._visibility.tells_of(ahead.frame):
                step = replace(record, ahead=ahead, tile_bytes=0)
                out += self._upgrades(self._visibility.tiles(ahead.frame), step, now_us, passing=True)
                record.tile_bytes += step.tile_bytes
        return out

    def _upgrades(
        self, visible: tuple[VisibleTile, ...], record: FrameRecord, now_us: int, *, passing: bool = False
    ) -> list[ev.Outgoing]:
        """The tiles chosen by the rate policy for a frame, and the end of the frame; ``passing``: it is planned beside
        the later one that is planned at that time.
        """
        camera = Camera(self._hello.intrinsics, record.predicted, self._hello.near)
        ahead = record.ahead
        if not passing:
            visible += self._come_into_view(record, visible) + self._following(record, visible)
        visible = self._visibility.with_ghosts(visible, ahead.frame, camera, self._tiles.inventory, self._tiles.age)
        decision = self._decide(visible, record, now_us, passing=passing)
        deadline_us = self._viewer.clock.to_server(ahead.display_us) + int(self._settings.tile_deadline_ms * 1000)
        out = self._tiles.upgrades(ahead.frame, decision.upgrades, deadline_us)
        self._ends.queued(out, ahead.display_us)
        return self._counted(out, now_us)

    def _reserve_is_full(self, record: FrameRecord) -> bool:
        """Whether what a larger reserve would reach next is not to be reached yet: because of what the client would
        hold, or because it is in another group of frames than the displayed one, of which nothing was seen.
        """
        schedule, gof_of = self._schedule, self._library.manifest.gof_of
        after = schedule.media_frame(schedule.ahead(record.tick, schedule.reserve.frames + 2))
        if after is None or after <= record.frame:  # the clip ends, or begins again
            return False
        if gof_of(after) != gof_of(record.frame):
            return True
        return self._library.tile_map(after).new_splats(record.frame, after) > RESERVED_SPLATS

    def _come_into_view(self, record: FrameRecord, visible: tuple[VisibleTile, ...]) -> tuple[VisibleTile, ...]:
        """Tiles of a nearer frame than the reserve has reached, of which the client holds nothing: when that frame was
        planned, the viewer did not see them.
        """
        every = 1 if self._library.manifest.motion is None else LOOK_BACK_EVERY
        if not self._schedule.reserve.grown or record.tick % every:
            return ()
        near = self._schedule.media_frame(self._schedule.ahead(record.tick, self._settings.tiles_ahead))
        if near is None or near >= record.ahead.frame or not self._visibility.tells_of(near):
            return ()
        known = {(tile.frame, tile.tile) for tile in visible}
        tiles = [tile for tile in self._visibility.tiles(near) if (tile.frame, tile.tile) not in known]
        return tuple(tile for tile in tiles if not self._tiles.inventory.depth(tile.frame, tile.tile))

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

    def _following(self, record: FrameRecord, visible: tuple[VisibleTile, ...]) -> tuple[VisibleTile, ...]:
        """What begins in the frames after the one that the viewer is paused at, once that one is about as good as it
        will be: the first frames of a play would otherwise all be due at once. Their ends come with the play.
        """
        frame = record.ahead.frame
        if self._schedule.timeline.playing or not self._held_is_good or not self._visibility.tells_of(frame):
            return ()
        begins = self._beginning_after(frame) if self._followers is None else self._followers
        self._followers = tuple(tile for tile in begins if not self._tiles.view(tile, tile.frame, 0.0).complete)
        known = {(tile.frame, tile.tile) for tile in visible}
        return tuple(tile for tile in self._followers if (tile.frame, tile.tile) not in known)

    def _beginning_after(self, frame: int) -> tuple[VisibleTile, ...]:
        """Tiles in view that begin within :attr:`~cags_server.settings.ServerSettings.tiles_ahead` frames of its group
        after ``frame``, each as seen in the first of these frames.
        """
        manifest = self._library.manifest
        last = min(frame + self._settings.tiles_ahead, manifest.gof_frames(manifest.gof_of(frame))[-1])
        found: dict[tuple[int, int], VisibleTile] = {}
        for later in range(frame + 1, last + 1):
            for tile in self._visibility.tiles(later):
                if tile.frame > frame:
                    found.setdefault((tile.frame, tile.tile), tile)
        return tuple(found.values())

    def _decide(self, visible: tuple[VisibleTile, ...], record: FrameRecord, now_us: int, *, passing: bool) -> Decision:
        record.estimate_bps = self._link.estimate_bps(now_us)
        frame, display_us = record.ahead.frame, record.ahead.display_us
        to_display_us = self._viewer.clock.to_server(display_us) - now_us
        longest_us = self._schedule.lead_us + self._settings.tiles_ahead * self._schedule.planned_period_us
        lead_frames = min(to_display_us, longest_us) / self._schedule.timeline.period_us
        views = [self._tiles.view(tile, frame, lead_frames) for tile in visible]
        record.level = mean_level(views)
        tiles = tuple(view for view in views if view.kind == TileKind.LOOKS or not view.complete)
        period_us = self._schedule.planned_period_us
        earned_bytes = self._budget.open(record, self._schedule.timeline.period_us, now_us)
        spare_us = float(to_display_us - MARGIN_US)
        now = (tile for tile in tiles if not tile.depth and tile.frame <= frame)
        fresh = [tile.lod_bytes[0] + MESSAGE_OVERHEAD_BYTES for tile in now]
        timely_bytes = self._budget.timely(spare_us, period_us, max(fresh, default=0), now_us)
        room_bytes = max(self._budget.room(period_us, now_us), timely_bytes)
        record.budget_bytes = min(earned_bytes, room_bytes)
        observation = Observation(
            frame=frame,
            budget_bytes=record.budget_bytes,
            tiles=tiles,
            lod_gains_db=self._library.manifest.lod_gains_db,
            still_errors=self._library.still_errors,
            outdated_error=self._library.outdated_error,
            message_overhead_bytes=MESSAGE_OVERHEAD_BYTES,
            layered=self._tiles.layered,
            waiting_us=self._budget.waiting_us(now_us),
            timely_bytes=timely_bytes,
            alone_bytes=self._budget.alone(earned_bytes, period_us, now_us),
            frame_bytes=record.estimate_bps * self._schedule.timeline.period_us / 8e6,
        )
        decision = self._policy.decide(observation)
        lacking = lacking_bytes(observation)
        coming_bytes = self._budget.outstanding_bytes + lacking
        self._worth.observe(coming_bytes, record.estimate_bps, self._schedule.timeline.period_us)
        self._decided_us = now_us
        if not passing:
            self._held_is_good |= not lacking
            found = supply(observation, decision)
            self._newest = None if found is Supply.COMPLETE else record
            if self._reserve_is_full(record):
                self._schedule.reserve.hold()
            else:
                self._schedule.reserve.planned(found, period_us=period_us)
        record.tile_bytes += decision.bytes
        self._budget.close(earned_bytes - decision.bytes, now_us)
        record.visible_tiles, record.upgrades = len(visible), len(decision.upgrades)
        return decision

    # ------------------------------------------------------------------------------------------------------ messages

    def outdated(self, outgoing: ev.Outgoing, now_us: int) -> bool:
        """Whether a waiting tile is for a frame that has been displayed, or the end of a frame would be late: another
        tile may be worth more now, and for ends see :meth:`take_late_ends`.
        """
        message, deadline_us = outgoing.message, outgoing.deadline_us
        if isinstance(message, FrameEnd):
            return self._ends.has(message.frame, self._late_until_us(now_us))
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

    def _is_behind(self, now_us: int) -> bool:
        """Whether the next reference is of no use because the client shows an older frame.

        A difference assumes what was sent before it, and the client shows no more than that: the end of its frame must
        be out. A picture assumes nothing, so it is of use until the client stands still. Where splats are sent anew for
        every frame, an older frame with its difference is better than a newer one without its splats.
        """
        if self._coder.kind is ReferenceKind.DIFFERENCE and not self._sends_anew:
            return self._ends.any_until(self._schedule.timeline.display_us(self._schedule.next_tick))
        return self._ends.any_until(self._viewer.clock.to_client(now_us))

    def take_late_ends(self, now_us: int) -> list[ev.Outgoing]:
        """Frame ends that would be late where they wait, to queue again ahead of all else."""
        return self._counted(self._ends.again(), now_us)

    def _display_us(self, deadline_us: int) -> int:
        """Display time of the frame of a reference that is useful until ``deadline_us``; both by the server's clock."""
        return deadline_us - int(self._settings.reference_deadline_ms * 1000)

    def _reference_deadline_us(self, display_us: int) -> int:
        """A late reference is still useful for the frames after its own."""
        return self._viewer.clock.to_server(display_us) + int(self._settings.reference_deadline_ms * 1000)

    def _counted(self, outgoing: list[ev.Outgoing], now_us: int) -> list[ev.Outgoing]:
        for each in outgoing:
            size = len(each.payload)
            self._budget.planned(each, now_us)
            if isinstance(each.message, TileLayers):
                self.stats.bytes_tiles += size
            elif isinstance(each.message, ReferenceFrame):
                self.stats.bytes_reference += size
            else:
                self.stats.bytes_other += size
            if isinstance(each.message, FrameEnd):
                self._arrivals.sent(each.message.frame)
        return outgoing
