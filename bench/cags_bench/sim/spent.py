"""What the two sides of a session take of the processor: the server for its references, the client for its frames."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TypeVar

from cags_server.reference.job import FrameJob, FrameRender

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


@dataclass
class Spent:
    """Account of one session."""

    references: list[ReferenceCost] = field(default_factory=list)
    decoding_ms: float = 0.0
    """Processor time of the client's decoding in the whole session."""
    presenting_ms: float = 0.0
    frames: int = 0
    """That were presented."""

    def job(self, job: FrameJob) -> FrameRender:
        """Run a server's job."""
        wall = time.perf_counter()
        done = job.run(time.process_time_ns)
        wall_ms = (time.perf_counter() - wall) * 1e3
        truth_ms, mirror_ms, coding_ms = (ns / 1e6 for ns in (done.render_ns, done.mirror_ns, done.encode_ns))
        self.references.append(ReferenceCost(truth_ms, mirror_ms, coding_ms, wall_ms))
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
