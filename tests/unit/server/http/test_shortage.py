"""What a session is short of, and what the log says of it."""

from __future__ import annotations

import logging

import pytest

from cags_common.geometry import Pose
from cags_server.http.metrics import exposition
from cags_server.http.shortage import LOOK_EVERY_S, ShortageLog, shortage
from cags_server.http.status import SessionBook, page
from cags_server.records import Ahead, FrameRecord, StreamStats, Totals
from support.streamer_rig import PERIOD_US

RICH, FULL = {"budget_bytes": 1000, "tile_bytes": 100}, {"budget_bytes": 1000, "tile_bytes": 950}


def record(**changes: object) -> FrameRecord:
    made = FrameRecord(0, 0, Ahead(1, round(2 * PERIOD_US)), 0, round(PERIOD_US), 0, Pose.identity(), (0.1, 0.1), 1)
    for name, value in changes.items():
        setattr(made, name, value)
    return made


def played(*, frames: int = 10, every: int = 1, common: dict[str, int] = RICH, **changes: object) -> StreamStats:
    """Figures of a session; of its frames every so many-th has ``changes``."""
    stats = StreamStats()
    for number in range(frames):
        stats.records.append(record(**common, **({} if number % every else changes)))
    return stats


def far_away(*late: bool, **changes: object) -> StreamStats:
    stats = played(**changes)  # type: ignore[arg-type]
    stats.lately.extend(late)
    return stats


@pytest.mark.parametrize(
    ("stats", "sentence"),
    [
        (StreamStats(), "nothing"),
        (played(), "nothing"),
        (played(common=FULL), "link: tiles take 95 % of its bytes"),
        (played(common=FULL, reference_late=True), "renderer: 100 % of the references are late or left out"),
        (played(common=FULL, no_place=True, every=2), "renderer: 50 % of the references are late or left out"),
        (played(no_place=True, every=5), "nothing"),
        (played(ticks_covered=2), "nothing"),  # a client that displays every other frame
        (played(skipped=2, every=2), "processor: the server skips 50 % of the frames, being late"),
        (far_away(True, False), "link: 50 % of the frames come late"),  # over a second each way, with an idle link
        (far_away(True, False, False, False), "nothing"),
        (far_away(True, common=FULL), "link: tiles take 95 % of its bytes"),
        (
            played(common=FULL, reference_late=True, skipped=1),
            "processor: the server skips 50 % of the frames, being late",
        ),
    ],
)
def test_the_scarcest_resource_is_told_with_how_scarce_it_is(stats: StreamStats, sentence: str) -> None:
    assert str(shortage(stats)) == sentence


def test_page_and_metrics_say_it() -> None:
    book, late = SessionBook(), played(no_place=True, every=2)
    for name in ("s1", "s2"):
        book.began(name, "here")
    report = book.report([("s1", late), ("s2", played())])
    assert [session["short_of"] for session in report["sessions"]] == ["renderer", "nothing"]
    assert "renderer: 50 % of the references are late or left out" in page(report, "scene")
    text = exposition(Totals(), [late, played()])
    assert 'cags_sessions_short{of="renderer"} 1.0' in text
    assert 'cags_sessions_short{of="link"} 0.0' in text


def test_the_log_says_it_when_it_changes(caplog: pytest.LogCaptureFixture) -> None:
    now_s = [0.0]
    told = ShortageLog(logging.getLogger("test"), "s1", lambda: now_s[0])
    caplog.set_level(logging.INFO)
    for stats in (played(), played(no_place=True), played(no_place=True), played(skipped=2), played(common=FULL)):
        told.look(stats)
        told.look(StreamStats())  # too soon after the last
        now_s[0] += LOOK_EVERY_S
    assert [entry.getMessage() for entry in caplog.records] == [
        "s1: short of renderer: 100 % of the references are late or left out",
        "s1: short of processor: the server skips 67 % of the frames, being late",
        "s1: no longer short of processor",
    ]
