"""The client's behaviour in time, without sockets or clocks: session in, work out.

A shell moves bytes (``receive``, ``data_to_send``), sleeps until ``next_timer_us``, and does the work it is handed:

    while (action := player.next_action(now_us)) is not None:
        player.done(action, action.run(), now_us)      # inline, or in an executor

``Decode`` actions must run one after another; ``Present`` actions too, but beside the decoding. All times are the
client's clock, which is the session's master clock.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol, TypeAlias

from cags_client.pipeline import ClientPipeline, PresentedFrame
from cags_client.settings import ClientSettings, LiveSettings
from cags_common.bundle.manifest import Manifest
from cags_common.errors import CagsError, DecodeError, NetworkError
from cags_common.geometry import DEFAULT_NEAR, Pose
from cags_protocol import events as ev
from cags_protocol.client import ClientSession
from cags_protocol.limits import PROTOCOL_VERSION
from cags_protocol.messages import Control, Hello, PoseSample

CODEBOOKS_BLOB = "codebooks"
DECODE_BATCH = 32
"""Messages decoded in one go: enough to dequantise a tile once for all its layers, few enough to stay prompt."""

KEYFRAME_RETRY_US = 250_000
"""A lost reference video is asked for again after this long."""


class PoseSource(Protocol):
    """Where the viewer's head is. A :class:`~cags_common.poses.PoseTrace` is one; a mouse may be another."""

    def pose_at(self, t_us: int) -> Pose:
        """T_world_camera at a time of the walk: 0 when play is asked for, ``start_delay_ms`` at the first frame."""
        ...


DataEvent: TypeAlias = ev.TileReceived | ev.ReferenceReceived | ev.FrameEnded


@dataclass(frozen=True)
class DecodeResult:
    """What a :class:`Decode` found."""

    errors: tuple[DecodeError, ...]
    needs_idr: bool
    whole: int
    """The latest frame whose end was decoded; -1 if none was."""


@dataclass(frozen=True, eq=False)
class Decode:
    """Messages to decode; :meth:`run` returns what came of it.

    Tiles go first, all at once: the end of a frame never overtakes what belongs to it.
    """

    events: tuple[DataEvent, ...]
    pipeline: ClientPipeline

    def run(self) -> DecodeResult:
        """Decode into the pipeline. A damaged message is left out and reported; the others count."""
        tiles = [(event.message, event.payload) for event in self.events if isinstance(event, ev.TileReceived)]
        errors = self.pipeline.on_tiles(tiles)
        needs_idr, whole = False, -1
        for event in self.events:
            try:
                match event:
                    case ev.ReferenceReceived(reference, payload):
                        needs_idr = not self.pipeline.on_reference(reference, payload)
                    case ev.FrameEnded(end, payload):
                        self.pipeline.on_frame_end(end, payload)
                        whole = max(whole, end.frame)
            except DecodeError as error:
                errors.append(error)
                needs_idr |= isinstance(event, ev.ReferenceReceived)
        try:
            self.pipeline.flush()
        except DecodeError as error:
            errors.append(error)
        return DecodeResult(tuple(errors), needs_idr, whole)


@dataclass(frozen=True, eq=False)
class Present:
    """A frame to draw: due at ``due_us``, seen from ``pose`` (sampled then)."""

    frame: int
    due_us: int
    pose: Pose
    pipeline: ClientPipeline
    traffic: Traffic

    def run(self) -> PresentedFrame:
        """Draw it."""
        return self.pipeline.present(self.frame, self.pipeline.camera(self.pose))


@dataclass(frozen=True, slots=True)
class Traffic:
    """Payload bytes that arrived since the frame before."""

    tiles_bytes: int = 0
    reference_bytes: int = 0


@dataclass(eq=False)
class PlayStats:
    """Counts over a whole play."""

    frames: int = 0
    """Frames presented."""
    missed: int = 0
    """Presented without all of their data."""
    dropped: int = 0
    """Not presented because the one after was due already."""
    decode_errors: int = 0
    keyframe_requests: int = 0
    bytes_tiles: int = 0
    bytes_reference: int = 0
    bytes_other: int = 0
    first_byte_us: int | None = None
    last_byte_us: int = 0
    started_us: int | None = None
    """When the first frame was due."""
    notices: list[str] = field(default_factory=list)


class Player:
    """Joins, waits for the first key frame, plays to the end of the clip and leaves."""

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
    ) -> None:
        self.settings = settings
        self.live = live or LiveSettings(settings)
        self.pipeline: ClientPipeline | None = None
        self.info: Manifest | None = None
        self.error: CagsError | None = None
        """Why it ended early, if it did."""
        self.finished = False
        self.stats = PlayStats()
        self._session, self._poses, self._clock = session, poses, clock
        self._made_us = now_us
        self._codebooks: bytes | None = None
        self._decodes: deque[DataEvent] = deque()
        self._decoding = self._presenting = False
        self._next_frame = settings.start_frame
        self._due_us: int | None = None
        self._end_frame = settings.start_frame + 1
        self._next_pose_us = now_us
        self._asked_idr_us: int | None = None
        self._tiles_bytes = self._reference_bytes = 0
        pose = poses.pose_at(0)
        hello = Hello(
            PROTOCOL_VERSION, settings.intrinsics, pose, near, settings.start_frame, settings.token, "cags-client"
        )
        session.hello(hello, now_us=now_us)

    # ---------------------------------------------------------------------------------------------------------- session

    def receive(self, data: bytes, now_us: int) -> None:
        """Take one message from the wire."""
        if self.stats.first_byte_us is None:
            self.stats.first_byte_us = now_us
        self.stats.last_byte_us = now_us
        self._session.receive(data, now_us=now_us)
        self._pump(now_us)

    def data_to_send(self, now_us: int) -> list[bytes]:
        """Messages to write now."""
        return self._session.data_to_send(now_us)

    def next_timer_us(self) -> int | None:
        """When :meth:`handle_timer` and :meth:`next_action` want to be called at the latest; None: not by time."""
        if self.finished:
            return None
        times = [self._session.next_timer_us(), self._next_pose_us]
        if not self._presenting:
            times.append(self._due_us)
        return min((t for t in times if t is not None), default=None)

    def handle_timer(self, now_us: int) -> None:
        """Do what is due: keep-alive, acknowledgements, poses."""
        if self.stats.started_us is None and now_us - self._made_us > self.settings.join_timeout * 1e6:
            self._fail(NetworkError(f"no first frame within {self.settings.join_timeout:g} s; is the link too slow?"))
        self._session.handle_timer(now_us=now_us)
        self._send_poses(now_us)
        self._pump(now_us)

    def lost(self, reason: str, now_us: int) -> None:
        """The connection went away."""
        self._session.connection_lost(reason, now_us=now_us)
        if not self.finished:
            self._fail(NetworkError(f"the connection was lost ({reason}); start the server again or check the network"))

    # ------------------------------------------------------------------------------------------------------------- work

    def next_action(self, now_us: int) -> Decode | Present | None:
        """Work to do now, or None. At most one Decode and one Present are out at a time."""
        if self.finished or self.pipeline is None:
            return None
        if self._decodes and not self._decoding:
            return self._decode(self.pipeline)
        if self._due_us is not None and now_us >= self._due_us and not self._presenting:
            return self._present(now_us)
        return None

    def done(self, action: Decode | Present, result: DecodeResult | PresentedFrame, now_us: int) -> None:
        """Report a finished action and what its ``run`` returned."""
        if isinstance(action, Present):
            assert isinstance(result, PresentedFrame)
            self._presenting = False
            self.stats.frames += 1
            self.stats.missed += result.missed
            if self._next_frame >= self._end_frame:
                self._finish(now_us)
            return
        assert isinstance(result, DecodeResult)
        self._decoding = False
        self.stats.decode_errors += len(result.errors)
        if result.needs_idr:
            self._ask_idr(action.pipeline.last_reference_seq, now_us)
        if result.whole >= self.settings.start_frame:
            self._play(now_us)

    # ---------------------------------------------------------------------------------------------------------- details

    def _pump(self, now_us: int) -> None:
        while (event := self._session.next_event()) is not None:
            self._on_event(event, now_us)

    def _on_event(self, event: ev.ClientEvent, now_us: int) -> None:
        match event:
            case ev.Welcomed(welcome):
                self.info = Manifest.from_json(welcome.info)
                self._open(now_us)
            case ev.BlobReceived(name, data):
                self.stats.bytes_other += len(data)
                if name == CODEBOOKS_BLOB:
                    self._codebooks = data
                    self._open(now_us)
            case ev.TileReceived(_, payload):
                self._tiles_bytes += len(payload)
                self.stats.bytes_tiles += len(payload)
                self._decodes.append(event)
            case ev.ReferenceReceived(_, payload):
                self._reference_bytes += len(payload)
                self.stats.bytes_reference += len(payload)
                self._decodes.append(event)
            case ev.FrameEnded():
                self._decodes.append(event)
            case ev.NoticeReceived(notice):
                self.stats.notices.append(f"{notice.code}: {notice.message}")
            case ev.Refused(refusal):
                where = f" ({refusal.field})" if refusal.field else ""
                self._fail(NetworkError(f"the server refused{where}: {refusal.message}"))
            case ev.Closed(code, reason):
                if not self.finished:
                    self._fail(NetworkError(f"the session ended early ({code}: {reason})"))

    def _open(self, now_us: int) -> None:
        """Make the pipeline once manifest and codebooks are there."""
        if self.info is None or self._codebooks is None or self.pipeline is not None:
            return
        try:
            self.pipeline = ClientPipeline(self.info, self._codebooks, self.settings, live=self.live, clock=self._clock)
        except CagsError as error:
            self._fail(error)
            return
        last = self.info.frames
        if self.settings.duration is not None:
            last = min(last, self.settings.start_frame + max(1, round(self.settings.duration * self.info.fps)))
        self._end_frame = max(last, self.settings.start_frame + 1)

    def _play(self, now_us: int) -> None:
        """The first key frame is there: fix when it is shown, and tell the server."""
        if self._due_us is not None or self.stats.started_us is not None:
            return
        at_us = now_us + self.settings.start_delay_ms * 1000
        self._due_us = self.stats.started_us = at_us
        self._ask_to_play(at_us, now_us)

    def _ask_to_play(self, at_us: int, now_us: int) -> None:
        self._session.control(Control("play", self.settings.start_frame, at_us), now_us=now_us)

    def _frame_due_us(self, frame: int) -> int:
        assert self.info is not None
        assert self.stats.started_us is not None
        return self.stats.started_us + round((frame - self.settings.start_frame) * 1e6 / self.info.fps)

    def _decode(self, pipeline: ClientPipeline) -> Decode:
        self._decoding = True
        count = min(len(self._decodes), DECODE_BATCH)
        return Decode(tuple(self._decodes.popleft() for _ in range(count)), pipeline)

    def _present(self, now_us: int) -> Present:
        frame = self._next_frame
        if self.settings.drop_late:
            while frame + 1 < self._end_frame and self._frame_due_us(frame + 1) <= now_us:
                frame += 1
        self.stats.dropped += frame - self._next_frame
        self._next_frame, self._presenting = frame + 1, True
        due_us = self._frame_due_us(frame)
        self._due_us = self._frame_due_us(frame + 1) if self._next_frame < self._end_frame else None
        traffic = Traffic(self._tiles_bytes, self._reference_bytes)
        self._tiles_bytes = self._reference_bytes = 0
        assert self.pipeline is not None
        return Present(frame, due_us, self._pose(due_us), self.pipeline, traffic)

    def _pose(self, t_us: int) -> Pose:
        """The walk begins when play is asked for; until then the viewer waits at its beginning."""
        if self.stats.started_us is None:
            return self._poses.pose_at(0)
        return self._poses.pose_at(max(t_us - self.stats.started_us + self.settings.start_delay_ms * 1000, 0))

    def _send_poses(self, now_us: int) -> None:
        period_us = round(1e6 / self.settings.pose_rate)
        samples = []
        while self._next_pose_us <= now_us:
            samples.append(PoseSample(self._next_pose_us, self._pose(self._next_pose_us)))
            self._next_pose_us += period_us
        if samples:
            self._session.send_poses(samples[-64:], now_us=now_us)

    def _ask_idr(self, last_seq: int, now_us: int) -> None:
        if self._asked_idr_us is not None and now_us - self._asked_idr_us < KEYFRAME_RETRY_US:
            return
        self._asked_idr_us = now_us
        self.stats.keyframe_requests += 1
        self._session.request_keyframe(last_seq, now_us=now_us)

    def _finish(self, now_us: int) -> None:
        self.finished = True
        self._session.bye(now_us=now_us)

    def _fail(self, error: CagsError) -> None:
        self.finished = True
        self.error = self.error or error
