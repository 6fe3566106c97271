"""What the two sides of a session take of the processor: the server for its references, the client for its frames."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TypeVar

from cags_protocol.wire.messages import Buffer
from cags_server.reference.job import FrameJob, FrameRender
from cags_server.session.connection import Connection

Result = TypeVar("Result")


@dataclass(frozen=True, slots=True)
class ReferenceCost:
    """Processor time of one reference, over all its threads, milliseconds."""

    truth_ms: float
    """The scene's own splats drawn, with their contributions."""
    mirror_ms: float
    """The client's splats brought up to date and drawn; about 0 where references do not compare."""
    coding_ms: float
    wall_ms: float
    """All of it by the clock on the wall."""

    @property
    def total_ms(self) -> float:
        """Sum of all stages."""
        return self.truth_ms + self.mirror_ms + self.coding_ms


@dataclass(frozen=True, slots=True)
class Playing:
    """An account at the moment of the first frame's display: joining is over."""

    began_us: int
    references: int
    serving_ms: float


@dataclass
class Spent:
    """Account of one session."""

    references: list[ReferenceCost] = field(default_factory=list)
    serving_ms: float = 0.0
    """Processor time of the server beside its references: reading, choosing tiles, sending. Sockets are not in it."""
    mirror_bytes: int = 0
    """Most that the mirror of the client took."""
    references_late: int = 0
    """Frames whose reference was under way and was not there in time."""
    light: int = 0
    """References that were coded lightly."""
    decoding_ms: float = 0.0
    """Processor time of the client's decoding in the whole session."""
    presenting_ms: float = 0.0
    frames: int = 0
    """That were presented."""
    playing: Playing | None = None
    """Since when media is displayed; None before."""
    last_job_us: int = 0
    """When the server's last job was done, by the session's clock."""

    def begins_play(self, now_us: int) -> None:
        """The first media frame is displayed; later calls change nothing."""
        self.playing = self.playing or Playing(now_us, len(self.references), self.serving_ms)

    def job(self, job: FrameJob, now_us: int) -> FrameRender:
        """Run a server's job."""
        self.last_job_us = now_us
        wall = time.perf_counter()
        done = job.run(time.process_time_ns)
        wall_ms = (time.perf_counter() - wall) * 1e3
        truth_ms, mirror_ms, coding_ms = (ns / 1e6 for ns in (done.render_ns, done.mirror_ns, done.encode_ns))
        self.references.append(ReferenceCost(truth_ms, mirror_ms, coding_ms, wall_ms))
        self.light += job.plan.speaks and job.plan.light
        return done

    def decoding(self, work: Callable[[], Result]) -> Result:
        """Run a client's decoding."""
        began = time.process_time()
        result = work()
        self.decoding_ms += (time.process_time() - began) * 1e3
        return result

    def presenting(self, work: Callable[[], Result]) -> Result:
        """Run the presentation of a frame."""
        began = time.process_time()
        result = work()
        self.presenting_ms += (time.process_time() - began) * 1e3
        self.frames += 1
        return result

    @property
    def server_ms_a_frame(self) -> float:
        """Mean of the server's processor time for references over presented frames."""
        return sum(one.total_ms for one in self.references) / max(self.frames, 1)

    @property
    def client_ms_a_frame(self) -> float:
        """Mean of the client's processor time, decoding and drawing."""
        return (self.decoding_ms + self.presenting_ms) / max(self.frames, 1)


class MeteredConnection(Connection):
    """A connection whose every call is charged to an account; it does what any other does."""

    spent: Spent

    def receive(self, data: Buffer, now_us: int) -> None:
        """See :class:`Connection`, as all of these."""
        self._charged(lambda: super(MeteredConnection, self).receive(data, now_us))

    def data_to_send(self, now_us: int, max_bytes: int | None = None) -> list[bytes]:
        """Messages that may be written now."""
        return self._charged(lambda: super(MeteredConnection, self).data_to_send(now_us, max_bytes))

    def handle_timer(self, now_us: int) -> None:
        """Do what is due."""
        self._charged(lambda: super(MeteredConnection, self).handle_timer(now_us))

    def next_job(self, now_us: int) -> FrameJob | None:
        """The next frame to render."""
        return self._charged(lambda: super(MeteredConnection, self).next_job(now_us))

    def job_done(self, render: FrameRender, now_us: int) -> None:
        """A job has ended well: the rate policy chooses."""
        self._charged(lambda: super(MeteredConnection, self).job_done(render, now_us))
        self.spent.mirror_bytes = max(self.spent.mirror_bytes, self.stats.mirror_bytes)
        self.spent.references_late = self.stats.references_late

    def _charged(self, work: Callable[[], Result]) -> Result:
        began = time.process_time_ns()
        try:
            return work()
        finally:
            self.spent.serving_ms += (time.process_time_ns() - began) / 1e6
