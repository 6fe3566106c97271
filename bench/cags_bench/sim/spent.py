"""Processor time of both sides of a session: references on the server, frames on the client."""

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
    """Processor time of one reference over all threads, milliseconds."""

    truth_ms: float
    """Rendering the source splats, with contributions."""
    mirror_ms: float
    """Updating and rendering the client's splats; about 0 if references are not differences."""
    coding_ms: float
    wall_ms: float
    """Wall-clock time of all stages."""

    @property
    def total_ms(self) -> float:
        """Sum of all stages."""
        return self.truth_ms + self.mirror_ms + self.coding_ms


@dataclass(frozen=True, slots=True)
class Playing:
    """State of an account when the first frame is displayed and joining is complete."""

    began_us: int
    references: int
    serving_ms: float


@dataclass
class Spent:
    """Account of one session."""

    references: list[ReferenceCost] = field(default_factory=list)
    serving_ms: float = 0.0
    """Server's processor time apart from references: reading, choosing tiles, sending; without sockets."""
    mirror_bytes: int = 0
    """Largest size of the mirror of the client."""
    references_late: int = 0
    """Number of frames whose reference was being rendered but was late."""
    light: int = 0
    """Number of references with light coding."""
    decoding_ms: float = 0.0
    """Processor time of the client's decoding in the whole session."""
    presenting_ms: float = 0.0
    frames: int = 0
    """Number of presented frames."""
    playing: Playing | None = None
    """State at the start of playback; None before it."""
    last_job_us: int = 0
    """When the server's last job ended, on the session's clock."""

    def begins_play(self, now_us: int) -> None:
        """Called when the first media frame is displayed; later calls have no effect."""
        self.playing = self.playing or Playing(now_us, len(self.references), self.serving_ms)

    def job(self, job: FrameJob, now_us: int) -> FrameRender:
        """Run a job of the server."""
        self.last_job_us = now_us
        wall = time.perf_counter()
        done = job.run(time.process_time_ns)
        wall_ms = (time.perf_counter() - wall) * 1e3
        truth_ms, mirror_ms, coding_ms = (ns / 1e6 for ns in (done.render_ns, done.mirror_ns, done.encode_ns))
        self.references.append(ReferenceCost(truth_ms, mirror_ms, coding_ms, wall_ms))
        self.light += job.plan.speaks and job.plan.light
        return done

    def decoding(self, work: Callable[[], Result]) -> Result:
        """Run decoding of the client."""
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
        """Mean server time for references per presented frame."""
        return sum(reference.total_ms for reference in self.references) / max(self.frames, 1)

    @property
    def client_ms_a_frame(self) -> float:
        """Mean client time for decoding and drawing per presented frame."""
        return (self.decoding_ms + self.presenting_ms) / max(self.frames, 1)


class MeteredConnection(Connection):
    """A connection that measures the processor time of every call."""

    spent: Spent

    def receive(self, data: Buffer, now_us: int) -> None:
        """See :class:`Connection`; so for all methods here."""
        self._charged(lambda: super(MeteredConnection, self).receive(data, now_us))

    def data_to_send(self, now_us: int, max_bytes: int | None = None) -> list[bytes]:
        """Messages that may be written now."""
        return self._charged(lambda: super(MeteredConnection, self).data_to_send(now_us, max_bytes))

    def handle_timer(self, now_us: int) -> None:
        """See :class:`Connection`."""
        self._charged(lambda: super(MeteredConnection, self).handle_timer(now_us))

    def next_job(self, now_us: int) -> FrameJob | None:
        """The next frame to render."""
        return self._charged(lambda: super(MeteredConnection, self).next_job(now_us))

    def job_done(self, render: FrameRender, now_us: int) -> None:
        """A job has succeeded; the rate policy chooses tiles."""
        self._charged(lambda: super(MeteredConnection, self).job_done(render, now_us))
        self.spent.mirror_bytes = max(self.spent.mirror_bytes, self.stats.mirror_bytes)
        self.spent.references_late = self.stats.references_late

    def _charged(self, work: Callable[[], Result]) -> Result:
        began = time.process_time_ns()
        try:
            return work()
        finally:
            self.spent.serving_ms += (time.process_time_ns() - began) / 1e6
