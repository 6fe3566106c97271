"""What is remembered of each planned frame, for reports and metrics, and its file: one a session. Bounded."""

from __future__ import annotations

import json
import secrets
import time
from collections import deque
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

from cags_common.files import whole_file, writable_folder
from cags_common.geometry import Pose, angle_between
from cags_protocol.events import Closed

FORMAT = "cags-session"

MAX_RECORDS = 8192
"""Frames remembered a client (four and a half minutes at 30 fps)."""

RECENT_FRAMES = 60
"""Number of last frames by which a session's state is judged."""


@dataclass(frozen=True, slots=True)
class Ahead:
    """The frame whose tiles go out beside a reference: they are there before its own reference is made."""

    frame: int
    display_us: int  # client clock


@dataclass(slots=True)
class FrameRecord:
    """One planned frame. The errors are None until the true pose of its display time has arrived."""

    tick: int
    frame: int
    ahead: Ahead
    """The frame whose tiles were chosen."""
    planned_us: int  # server clock
    display_us: int  # client clock
    horizon_us: int
    predicted: Pose
    margins: tuple[float, float]
    ticks_covered: int
    """Ticks since the plan before it, its own included: each earns the bytes of its time."""
    estimate_bps: float = 0.0
    budget_bytes: int = 0
    tile_bytes: int = 0
    reference_bytes: int = 0
    reference_kind: str = ""
    """What the reference says; empty: there was none."""
    lacking: float = 0.0
    """Mean squared error of the client's splats seen from the reference camera, as far as they were compared."""
    left: float | None = 0.0
    """The same after correction; None: nobody looked."""
    visible_tiles: int = 0
    level: float = 0.0
    """Mean level that the client holds of the looks in view, weighted by their share of the picture."""
    upgrades: int = 0
    skipped: int = 0
    """Ticks before it that the client displays, and that no plan was made for because the server was late."""
    reference_late: bool = False
    no_place: bool = False
    """Whether it went without a reference because the renderer had too much to do."""
    angular_error_rad: float | None = None
    position_error_m: float | None = None

    def settle(self, actual: Pose) -> None:
        """The viewer's true pose at ``display_us`` is known."""
        self.angular_error_rad = angle_between(self.predicted.rotation, actual.rotation)
        squares = [(a - b) ** 2 for a, b in zip(self.predicted.position, actual.position, strict=True)]
        self.position_error_m = sum(squares) ** 0.5


@dataclass(frozen=True)
class ReferenceCosts:
    """What references of one kind took, by the clock of those who made them."""

    references: int = 0
    render_ns: int = 0
    """Truth and mirror drawn."""
    encode_ns: int = 0

    def __add__(self, other: ReferenceCosts) -> ReferenceCosts:
        """Those of both."""
        return ReferenceCosts(
            self.references + other.references, self.render_ns + other.render_ns, self.encode_ns + other.encode_ns
        )


@dataclass
class StreamStats:
    """Totals and recent records of one client."""

    records: deque[FrameRecord] = field(default_factory=lambda: deque(maxlen=MAX_RECORDS))
    levels: int = 0
    """Of the scene's tiles."""
    frames: int = 0
    frames_skipped: int = 0
    """Frames that were due, and not planned because the server was late."""
    frames_in_time: int = 0
    """Frames whose data the client had when they were due; it may have skipped some of them."""
    frames_late: int = 0
    """Frames whose data came after they were due, or not at all."""
    stalls: int = 0
    """Runs of late frames."""
    lately: deque[bool] = field(default_factory=lambda: deque(maxlen=RECENT_FRAMES))
    """Whether the last frames that were due were late."""
    references_late: int = 0
    references: int = 0
    bytes_tiles: int = 0
    """Payloads of messages that were sent to their end; the same of references and of all others."""
    bytes_reference: int = 0
    bytes_other: int = 0
    bytes_dropped: int = 0
    """Sent of messages that the client did not get."""
    mirror_bytes: int = 0
    """Memory of the copy of what the client shows."""
    careful: ReferenceCosts = field(default_factory=ReferenceCosts)
    light: ReferenceCosts = field(default_factory=ReferenceCosts)
    """What references took, those that were coded lightly apart; drawings that only look are in neither."""
    bandwidth_bps: float = 0.0
    rtt_us: int = 0


RECENT = ("records", "lately")
"""Fields that are of the last frames."""


@dataclass
class Totals:
    """Sums over sessions: :meth:`add` counts one in, one that has ended or one that goes on."""

    sessions: int = 0
    frames: int = 0
    frames_skipped: int = 0
    frames_in_time: int = 0
    frames_late: int = 0
    stalls: int = 0
    references: int = 0
    references_late: int = 0
    bytes_tiles: int = 0
    bytes_reference: int = 0
    bytes_other: int = 0
    careful: ReferenceCosts = field(default_factory=ReferenceCosts)
    light: ReferenceCosts = field(default_factory=ReferenceCosts)

    def add(self, stats: StreamStats) -> None:
        """Count a session in."""
        self.sessions += 1
        self.frames += stats.frames
        self.references += stats.references
        self.frames_skipped += stats.frames_skipped
        self.frames_in_time += stats.frames_in_time
        self.frames_late += stats.frames_late
        self.stalls += stats.stalls
        self.references_late += stats.references_late
        self.bytes_tiles += stats.bytes_tiles
        self.bytes_reference += stats.bytes_reference
        self.bytes_other += stats.bytes_other
        self.careful += stats.careful
        self.light += stats.light


def run_name() -> str:
    """A name for the files of one process: when it began (UTC), and what tells it from others of that second.

    Sessions are numbered anew in each process, and several processes may write into one folder.
    """
    return f"{time.strftime('%Y%m%dT%H%M%SZ', time.gmtime())}-{secrets.token_hex(2)}"


def write_session(folder: Path, run: str, name: str, stats: StreamStats, ending: Closed | None) -> Path:
    """Write what is remembered of a session of :func:`run_name` ``run`` to ``RUN-NAME.jsonl``.

    The first line describes the file, the last the session's end.

    Raises :class:`OutputError` where it cannot be written.
    """
    path = writable_folder(folder) / f"{run}-{name}.jsonl"
    with whole_file(path) as writing, writing.open("w", encoding="utf-8") as file:
        head = {
            "format": FORMAT,
            "version": 1,
            "session": name,
            "clocks": {"planned_us": "server", "display_us": "client"},
        }
        print(json.dumps(head), file=file)
        for record in stats.records:
            print(json.dumps(asdict(record)), file=file)
        rest = asdict(replace(stats, records=deque(), lately=deque()))
        end = {name: value for name, value in rest.items() if name not in RECENT}
        end["ending"] = None if ending is None else {"code": ending.code, "reason": ending.reason}
        print(json.dumps(end), file=file)
    return path
