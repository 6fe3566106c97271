"""The client's behaviour over time, without sockets or clocks.

A shell moves bytes (``receive``, ``data_to_send``), sleeps until ``next_timer_us``, and does the work it is given:

    while (action := player.next_action(now_us)) is not None:
        player.done(action, action.run(), now_us)      # inline, or in an executor

At the start each server is asked once. Later a dropped connection does not end playback. The picture is held and
re-projected while ``wants_connection`` asks the shell to open another; the shell answers by ``connected``, or by
``lost``, and is asked again later. The new session learns what the client holds, so that nothing is sent twice, and
where playback stands.

``Decode`` actions must run one after another, and so must ``Present`` actions, but the two kinds run in parallel. All
times are those of the client's clock, which is the session's master clock.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import replace

from cags_client.frame.pipeline import ClientPipeline
from cags_client.frame.presented import PresentedFrame
from cags_client.frame.restore import references_wanted
from cags_client.net.reconnect import Reconnect
from cags_client.playback.decode_queue import MAX_UNDECODED_BYTES, DecodeQueue
from cags_client.playback.endings import FATAL_ENDS, FATAL_REFUSALS, affordable, refused
from cags_client.playback.interpolation import Interpolation, Moment
from cags_client.playback.jobs import DataEvent, Decode, DecodeResult, Present, Restarted, Traffic
from cags_client.playback.quality import SCALES, Quality, newest_due, next_due
from cags_client.playback.startup import Startup
from cags_client.playback.viewpoint import PoseSource, Viewpoint
from cags_client.settings import OFF, ClientSettings, LiveSettings
from cags_client.stats import PlayStats
from cags_common.bundle.manifest import Manifest
from cags_common.errors import BundleError, CagsError, DecodeError, NetworkError
from cags_common.geometry import DEFAULT_NEAR, Pose
from cags_protocol import events as ev
from cags_protocol.sessions.base import SessionTimers
from cags_protocol.sessions.blobs import BASE_CODEBOOKS_BLOB, CODEBOOKS_BLOB, WEIGHTS_BLOB
from cags_protocol.sessions.client import ClientSession, ClientSessionSettings
from cags_protocol.timeline import Timeline
from cags_protocol.wire.inventory import pack_inventory, unpack_inventory
from cags_protocol.wire.limits import PROTOCOL_VERSION
from cags_protocol.wire.messages import Control, Hello, Welcome

KEYFRAME_RETRY_US = 250_000
"""Interval between requests for an IDR picture, microseconds."""

RESUMING = ClientSessionSettings(SessionTimers(handshake_us=3_000_000))
"""Time limit for the answer of a server that takes over; another one may be available."""


class Player:
    """Plays a clip: joins, waits for the first key frame, plays to the end and leaves."""

    def __init__(
        self,
        session: ClientSession,
        settings: ClientSettings,
        poses: PoseSource,
        *,
        now_us: int,
        near: float = DEFAULT_NEAR,
        live: LiveSettings | None = None,
        clock: Callable[[], float] = lambda: 0.0,
        rng: random.Random | None = None,
        others: int = 0,
    ) -> None:
        """``session`` is the first one; ``rng`` randomises the intervals between attempts to reconnect. ``others`` are
        the servers to ask if the first one is full, or ends the session before it has begun.
        """
        self.settings = settings
        self.live = live or LiveSettings(settings)
        self.pipeline: ClientPipeline | None = None
        self.info: Manifest | None = None
        self.error: CagsError | None = None
        """The reason for an early end, if any."""
        self.finished = False
        self.stats = PlayStats()
        self._session, self._clock = session, clock
        self._viewpoint = Viewpoint(poses, settings.pose_rate, settings.start_delay_ms * 1000, now_us)
        self.stats.made_us, self._near = now_us, near
        self._reconnect = Reconnect(round(settings.reconnect_s * 1e6), rng or random.Random(0), others)  # noqa: S311
        self._lost_us = 0
        self._why_away = NetworkError("the connection was lost")
        self.rejoining = False
        """Whether the connection is away by the client's own wish, for a moment."""
        self._welcome: Welcome | None = None
        self._resume_at: Control | None = None
        self._codebooks: bytes | None = None
        self._weights: bytes | None = None
        self._decode_queue = DecodeQueue()
        self._restarts_due = 0  # jumps that discarded everything and that the server does not know of yet
        self._forgotten: int | None = None  # frame of the last one since the Hello that has no answer yet
        self._timeline = Timeline(fps=1.0, frames=1)
        """The clip's timeline once the manifest has come, which the ticks below count on too; one frame until then."""
        self._presenting, self._next_tick, self._end_tick = False, 0, 1
        self._asked_by = self._timeline
        """The timeline when the session was asked for, to notice what the viewer requested meanwhile."""
        self._preview_due = False  # more of the first frame has arrived than was shown
        self._startup = Startup(settings.startup_ms * 1000, now_us)
        self._quality = Quality(SCALES[self.live.resolution], 1e6 / settings.display_rate, skips=settings.drop_late)
        self._interpolation = Interpolation()
        self._begun_us = now_us  # the picture that is being drawn
        self._due_us: int | None = None
        self._asked_idr_us: int | None = None
        session.hello(self._hello(settings.start_frame, poses.pose_at(0)), now_us=now_us)

    # ---------------------------------------------------------------------------------------------------------- session

    def receive(self, data: bytes, now_us: int) -> None:
        """Take one message from the wire."""
        if self.stats.first_byte_us is None:
            self.stats.first_byte_us = now_us
        self.stats.last_byte_us = now_us
        self._session.receive(data, now_us=now_us)
        if self._session.partial_bytes:
            self._came(now_us, tile=False)
        self._pump(now_us)
        if self.backed_up and not (self.pipeline and self.pipeline.opens_tiles):
            self._fail(NetworkError("the server sends tiles without the codebooks that they need"))

    @property
    def backed_up(self) -> bool:
        """Whether so much data waits for the decoder that the shell should stop reading from the connection."""
        return self._decode_queue.undecoded_bytes > MAX_UNDECODED_BYTES

    def data_to_send(self, now_us: int) -> list[bytes]:
        """Messages to send now."""
        self._session.buffered_bytes = self._decode_queue.undecoded_bytes
        return self._session.data_to_send(now_us)

    def next_timer_us(self) -> int | None:
        """Latest time to call :meth:`handle_timer` and :meth:`next_action`; None for no time limit."""
        if self.finished:
            return None
        times = [self._session.next_timer_us(), self._viewpoint.next_us, self._reconnect.next_timer_us()]
        if self._waits_to_start:
            times.append(self._startup.ends_us)
        if not self._presenting:
            times += [self._due_us, self._interpolation.next_us()]
        return min((t for t in times if t is not None), default=None)

    def handle_timer(self, now_us: int) -> None:
        """Send what is due: keep-alive, acknowledgements, poses."""
        if self.stats.started_us is None and now_us - self.stats.made_us > self.settings.join_timeout * 1e6:
            why = f"no first frame within {self.settings.join_timeout:g} s; is the link too slow?"
            self._fail(NetworkError(why), now_us)
        if self._reconnect.expired(now_us):
            self._fail(self._why_away, now_us)
        self._play_if_due(now_us)
        self._session.handle_timer(now_us=now_us)
        if samples := self._viewpoint.due(now_us):
            self._session.send_poses(samples, now_us=now_us, cadence_permille=self._quality.permille)
        self._pump(now_us)

    def lost(self, reason: str, now_us: int) -> None:
        """The connection was lost, or the one that :meth:`wants_connection` asked for could not be opened."""
        attempt = self._reconnect.trying
        self.rejoining = False
        self._session.connection_lost(reason, now_us=now_us)
        self._pump(now_us)
        if attempt and self._reconnect.trying:  # there was no session yet to report the end
            self._try_again(now_us)

    @property
    def away(self) -> bool:
        """Whether the connection is lost and not yet restored, so that nothing can be sent."""
        return self._reconnect.away

    @property
    def attempts(self) -> int:
        """Attempts to reconnect since the connection was lost, including the current one; 0 before the first session,
        when no server is tried twice.
        """
        return 0 if self._welcome is None else self._reconnect.attempts

    def wants_connection(self, now_us: int) -> bool:
        """Whether to open a connection now. Answer by :meth:`connected` or :meth:`lost`."""
        return not self.finished and self._reconnect.begin(now_us)

    def connected(self, now_us: int) -> None:
        """A new connection is open: send a Hello with the inventory of held tiles."""
        self._session = ClientSession(None if self._welcome is None else RESUMING, now_us=now_us)
        self._restarts_due, self._forgotten = 0, None
        self._resume_at, self._asked_by = self._state_of_play(now_us), self._timeline
        frame = self.settings.start_frame if self._resume_at is None else self._resume_at.frame
        hello = self._hello(frame, self._viewpoint.pose_at(now_us))
        self._decode_queue.add(Restarted(unpack_inventory(hello.inventory)))
        self._session.hello(hello, now_us=now_us)

    def reshape(self, width: int, height: int, fov: float, now_us: int) -> None:
        """Pictures are of ``width`` x ``height`` pixels from now on, and ``fov`` degrees across.

        A server learns of it by a Hello alone: it is joined anew, with what is held, so that nothing is sent again.
        """
        self.settings = replace(self.settings, width=width, height=height, fov=fov)
        if self.pipeline is not None:
            self.pipeline.settings = self.settings
        if self.pipeline is not None and not self.away and self._reconnect.possible:
            self._rejoin(now_us)

    def leave(self, now_us: int) -> None:
        """End playback now, with a goodbye."""
        if not self.finished:
            self._finish(now_us)

    # ------------------------------------------------------------------------------------------------------------- work

    def next_action(self, now_us: int) -> Decode | Present | None:
        """Work to do now, or None. At most one Decode and one Present are outstanding."""
        if self.finished or self.pipeline is None:
            return None
        if batch := self._decode_queue.take(tiles=self.pipeline.opens_tiles):
            return Decode(batch, self.pipeline)
        if self._preview_due and not self._presenting and self.stats.started_us is None:
            return self._present_first(now_us)
        if self._due_us is not None and now_us >= self._due_us and not self._presenting:
            return self._present(now_us)
        if not self._presenting and (moment := self._interpolation.take(now_us, self._quality.fits)) is not None:
            return self._present_between(moment, now_us)
        return None

    def done(self, action: Decode | Present, result: DecodeResult | PresentedFrame, now_us: int) -> None:
        """Report a finished action and what its ``run`` returned."""
        if isinstance(action, Present):
            assert isinstance(result, PresentedFrame)
            self._presented(action, result, now_us)
            if action.media and self._next_tick >= self._end_tick:
                self._finish(now_us)
            return
        assert isinstance(result, DecodeResult)
        self._decode_queue.decoded()
        for error in result.errors:
            self.stats.damaged(error)
        whole, first = result.whole >= self.settings.start_frame, self.stats.first_picture_us is None
        waits = whole and self._codebooks is None  # for a while, before the play can begin
        self._preview_due |= result.references or waits if first else self._startup.preview(now_us)
        self._session.report_evictions(result.dropped)
        if result.needs_idr:
            self._ask_idr(action.pipeline.last_reference_seq, now_us)
        if whole and self._startup.whole(now_us):
            self._hold(now_us)

    # ---------------------------------------------------------------------------------------------------------- details

    def _presented(self, action: Present, result: PresentedFrame, now_us: int) -> None:
        """Count a picture, with separate counts for interpolated ones."""
        self._presenting = False
        if self.stats.first_picture_us is None:
            self.stats.first_picture_us = now_us
        if action.first:
            return
        self._quality.observe(now_us, now_us - self._begun_us, result.pixels_ms * 1e3, media=not action.share)
        if action.share:
            self.stats.interpolated += 1
            return
        self.stats.frames += 1
        self.stats.missed += result.missed

    def _pump(self, now_us: int) -> None:
        while (event := self._session.next_event()) is not None:
            self._on_event(event, now_us)

    def _on_event(self, event: ev.ClientEvent, now_us: int) -> None:
        match event:
            case ev.Welcomed(welcome):
                self._on_welcome(welcome, now_us)
            case ev.BlobReceived(name, data):
                self.stats.bytes_other += len(data)
                self._on_blob(name, data, now_us)
            case ev.TileReceived(_, payload):
                self._came(now_us, tile=True)
                self.stats.bytes_tiles += len(payload)
                self._take(event)
            case ev.ReferenceReceived(_, payload):
                self.stats.bytes_reference += len(payload)
                self._take(event)
            case ev.FrameEnded():
                self._take(event)
            case ev.MarkReceived(mark):
                self._restarts_due -= mark.restart and self._restarts_due > 0
                self._take(event)
            case ev.NoticeReceived(notice):
                self.stats.notice(f"the server says: {notice.message} ({notice.code})")
            case ev.Refused(refusal):
                self._why_away = refused(refusal)
                if refusal.code in FATAL_REFUSALS:
                    self._fail(self._why_away, now_us)
            case ev.Closed(code, reason):
                self._on_closed(code, reason, now_us)

    def _take(self, event: DataEvent) -> None:
        """Handle media, unless it was sent before the server learned of a jump that discarded everything."""
        if not self._restarts_due:
            self._decode_queue.add(event)

    def _forgot(self, frame: int) -> None:
        """Nothing is held any more, because the viewer jumped to ``frame``; the server is about to be told."""
        if self.away:
            self._forgotten = frame
        else:
            self._restarts_due += 1

    def _on_closed(self, code: str, reason: str, now_us: int) -> None:
        if self.finished:
            return
        if code == "lost":
            why = f"the connection was lost ({reason}); start the server again or check the network"
            self._why_away = NetworkError(why)
        elif code != "refused":
            self._why_away = NetworkError(f"the session ended early ({code}: {reason})")
        if code in FATAL_ENDS:
            self._fail(self._why_away, now_us)
            return
        if not self._reconnect.away:
            self._lost_us = now_us
        self.rejoining = False
        self._try_again(now_us)

    def _try_again(self, now_us: int) -> None:
        """Ask for another connection, if there may be one."""
        if self._reconnect.possible:
            self._reconnect.lost(now_us)
        else:
            self._fail(self._why_away)

    def _on_welcome(self, welcome: Welcome, now_us: int) -> None:
        if self.pipeline is not None and self._welcome is not None and welcome.info != self._welcome.info:
            self._fail(NetworkError("the server streams another scene now; start the client again"), now_us)
            return
        taken_up = self._reconnect.away and self._welcome is not None
        self._reconnect.restored(now_us)
        if taken_up:
            if not welcome.resumed:  # everything is sent again
                self._decode_queue.add(Restarted())
            if not self.rejoining:
                self.stats.reconnects += 1
                self.stats.away_us += now_us - self._lost_us
            self.rejoining = False
        self._welcome = welcome
        if self.pipeline is None:
            try:
                self.info = affordable(Manifest.from_json(welcome.info), self.settings)
            except (BundleError, NetworkError) as error:
                self._fail(error)
                return
            self._open(now_us)
        if self._forgotten is not None and welcome.resumed:  # the Hello spoke of more than is held
            self._session.control(Control("seek", self._forgotten, now_us), now_us=now_us)
            self._restarts_due += 1
        self._forgotten = None
        if self._resume_at is not None:
            if self._timeline is not self._asked_by:  # the viewer requested something meanwhile
                self._resume_at = self._state_of_play(now_us) or self._resume_at
            self._session.control(self._resume_at, now_us=now_us)
            self._go_on_by(self._resume_at)
            self._resume_at = None
        if self._said_view != self.settings.intrinsics and self._reconnect.possible:  # while this was on its way
            self._rejoin(now_us)

    def _came(self, now_us: int, *, tile: bool) -> None:
        """Something for the first frame has arrived: a tile, or codebooks, or a part of anything."""
        self._startup.came(now_us, tile=tile, equipped=self._codebooks is not None)

    def _on_blob(self, name: str, data: bytes, now_us: int) -> None:
        if name == CODEBOOKS_BLOB:
            self._on_codebooks(data)
            self._came(now_us, tile=False)
        elif name == BASE_CODEBOOKS_BLOB and self.pipeline is not None:
            self._try(self.pipeline.on_base_codebooks, data)
            self._came(now_us, tile=False)
        elif name == WEIGHTS_BLOB:
            self._weights = data
            self._take_weights()

    def _on_codebooks(self, data: bytes) -> None:
        if self._codebooks is not None and data != self._codebooks:
            self._fail(NetworkError("the server streams another encoding of the scene now; start the client again"))
        first, self._codebooks = self._codebooks is None, data
        if first and self.pipeline is not None:
            self._try(self.pipeline.on_codebooks, data)
            self._take_weights()

    def _try(self, take: Callable[[bytes], None], data: bytes) -> None:
        """Pass on data without which nothing can be shown."""
        try:
            take(data)
        except CagsError as error:
            self._fail(error)

    def _hello(self, frame: int, pose: Pose) -> Hello:
        """Start a session with the inventory, once there is a decoder for it."""
        resume, held = "", b""
        if self.pipeline is not None and self._welcome is not None and self._codebooks is not None:
            resume, held = self._welcome.session, pack_inventory(self._decode_queue.held(self.pipeline.held()))
        token, agent = self.settings.token, "cags-client"
        wanted, chroma = references_wanted(self.settings.restore), self.settings.chroma
        view = self._said_view = self.settings.intrinsics
        return Hello(PROTOCOL_VERSION, view, pose, self._near, frame, token, agent, resume, wanted, chroma, held)

    def _rejoin(self, now_us: int) -> None:
        self._session.bye(now_us=now_us)
        while self._session.next_event() is not None:
            pass  # its end is known, and what came last comes again
        self.rejoining = True
        self._lost_us = now_us
        self._reconnect.lost(now_us)

    def _state_of_play(self, now_us: int) -> Control | None:
        """The playback position when a server will have taken the session over; None before playback."""
        if self.stats.started_us is None:
            return None
        soon = self._timeline.first_tick(now_us + self.settings.start_delay_ms * 1000)
        tick = min(max(self._next_tick, soon), self._end_tick - 1)
        return Control("play", self._media_frame(tick), self._timeline.display_us(tick))

    def _open(self, now_us: int) -> None:
        """Create the pipeline when the manifest arrives; the codebooks follow."""
        if self.info is None or self.pipeline is not None:
            return
        self.pipeline = ClientPipeline(self.info, self.settings, live=self.live, clock=self._clock)
        self._timeline = Timeline(self.info.fps, self.info.frames, min(self.settings.start_frame, self.info.frames - 1))

    def _take_weights(self) -> None:
        """Pass the content's own weights to the pipeline when both exist; damaged weights are only reported."""
        if self.pipeline is None or self._weights is None:
            return
        data, self._weights = self._weights, None
        try:
            self.pipeline.on_weights(data)
        except DecodeError as error:
            self.stats.decode_errors += 1
            self.stats.notice(f"the scene's own weights are not used ({error})")

    def _hold(self, now_us: int) -> None:
        """The first frame has arrived: let the server refine it before playback."""
        assert self.pipeline is not None
        if self.settings.startup_ms:
            self._startup.greeting = self.pipeline.references_received
            self._session.control(Control("pause", self.settings.start_frame, now_us), now_us=now_us)
        self._play_if_due(now_us)

    @property
    def _waits_to_start(self) -> bool:
        return self._startup.ends_us is not None and self.stats.started_us is None and not self.away

    def _play_if_due(self, now_us: int) -> None:
        """When the first frame was held for long enough, fix its display time and tell the server."""
        ends_us = self._startup.ends_us
        if not self._waits_to_start or ends_us is None or now_us < ends_us:
            return
        if self._startup.greeting and self.pipeline is not None:
            self.pipeline.forget_references(self._startup.greeting)
        at_us = now_us + self.settings.start_delay_ms * 1000
        self.stats.started_us = at_us
        self._viewpoint.begin(at_us)
        self._ask_to_play(at_us, now_us)

    def _ask_to_play(self, at_us: int, now_us: int) -> None:
        self._control(Control("play", self.settings.start_frame, at_us), now_us)
        if self.settings.duration is not None:
            self._end_tick = min(self._end_tick, max(1, round(self.settings.duration * self._timeline.fps)))

    def _control(self, control: Control, now_us: int) -> None:
        """Restart the count of ticks by ``control``, and tell the server."""
        self._timeline = self._timeline.controlled(control)
        self._next_tick, self._end_tick, self._due_us = 0, self._timeline.round_end(0), control.at_us
        self._quality.period_us = self._timeline.period_us
        self._quality.restart()
        self._interpolation.cancel()
        self._session.control(control, now_us=now_us)

    def _go_on_by(self, control: Control) -> None:
        """A server that took over counts from ``control``, a position on the timeline; the display does not change."""
        if control.action == "play":
            passed = self._timeline.first_tick(control.at_us)
            self._next_tick, self._end_tick = self._next_tick - passed, self._end_tick - passed
            self._timeline = self._timeline.controlled(control)
        self._quality.restart()

    def _media_frame(self, tick: int) -> int:
        frame = self._timeline.media_frame(tick)
        assert frame is not None, "ticks past the end are not displayed"
        return frame

    def _present(self, now_us: int) -> Present:
        half, permille, display_us = self._begin(now_us), self._quality.permille, self._timeline.display_us
        tick = next_due(self._next_tick, self._end_tick, permille)
        if self.settings.drop_late:
            tick = newest_due(tick, self._end_tick, permille, lambda each: display_us(each) <= now_us)
        self.stats.dropped += tick - self._next_tick
        self._next_tick = tick + 1
        frame, due_us = self._media_frame(tick), display_us(tick)
        following = next_due(tick + 1, self._end_tick, permille)
        following_us = display_us(following)
        self._due_us = following_us if following > tick else None
        if self._quality.step_us is not None and following > tick:
            self._interpolation.begin(due_us, following_us, following - tick, self._quality.step_us)
        assert self.pipeline is not None
        pose, traffic = self._viewpoint.pose_at(due_us), self._decode_queue.traffic()
        return Present(frame, due_us, pose, self.pipeline, traffic, half=half)

    def _begin(self, now_us: int) -> bool:
        """A picture is begun, as the viewer wishes now; whether it is worked out at half resolution."""
        assert self.info is not None
        between = self.settings.interpolate if self.info.motion is not None else OFF
        self._quality.wish(SCALES[self.live.resolution], between)
        self._presenting, self._begun_us = True, now_us
        return self._quality.scale < 1

    def _present_first(self, now_us: int) -> Present:
        """A picture before playback: from a reference at first, and from the tiles received so far."""
        assert self.pipeline is not None
        self._preview_due = False
        frame, pose = self.settings.start_frame, self._viewpoint.pose_at(now_us)
        return Present(frame, now_us, pose, self.pipeline, Traffic(), first=True, half=self._begin(now_us))

    def _present_between(self, moment: Moment, now_us: int) -> Present:
        """An interpolated picture, before the next media frame is due."""
        assert self.pipeline is not None
        half, frame = self._begin(now_us), self._media_frame(self._next_tick - 1)
        pose = self._viewpoint.pose_at(moment.due_us)
        return Present(frame, moment.due_us, pose, self.pipeline, Traffic(), moment.share, half=half)

    def _ask_idr(self, last_seq: int, now_us: int) -> None:
        if self._asked_idr_us is not None and now_us - self._asked_idr_us < KEYFRAME_RETRY_US:
            return
        self._asked_idr_us = now_us
        self.stats.keyframe_requests += 1
        self._session.request_keyframe(last_seq, now_us=now_us)

    def _finish(self, now_us: int) -> None:
        self._count_away(now_us)
        self.finished = True
        self._session.bye(now_us=now_us)

    def _fail(self, error: CagsError, now_us: int | None = None) -> None:
        """End with an error; ``now_us`` where the connection may be away."""
        if now_us is not None:
            self._count_away(now_us)
        self.finished = True
        self.error = self.error or error

    def _count_away(self, now_us: int) -> None:
        """The play ends, with or without a session."""
        if self.away and self._welcome is not None and not self.rejoining and not self.finished:
            self.stats.away_us += now_us - self._lost_us
