"""Progress if stderr is not a terminal."""

import io
import threading
import time

import pytest

from cags_encoder.execution import progress
from cags_encoder.execution.progress import LINE_EVERY_S, ProgressLines, progress_bar


def test_a_line_now_and_then() -> None:
    out, now = io.StringIO(), [0.0]
    tell = ProgressLines(out, lambda: now[0]).tell
    for frame in range(1, 101):
        now[0] += LINE_EVERY_S / 10
        tell("encode", frame, 100)
    lines = out.getvalue().splitlines()
    assert lines[0] == "encoding frames: 10 of 100" and len(lines) == 10


def test_what_is_done_at_once_says_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    with progress_bar(lines=True) as tell:
        tell("encode", 1, 1)
    assert capsys.readouterr() == ("", "")


def test_a_step_that_takes_long_is_told_of_while_it_does() -> None:
    """Codebooks train for up to a minute, in which nothing was said."""
    out, now = io.StringIO(), [0.0]
    lines = ProgressLines(out, lambda: now[0])
    lines.look()
    lines.tell("codebooks", 0, 1)
    for _ in range(25):
        now[0] += LINE_EVERY_S / 10
        lines.look()
    lines.tell("codebooks", 1, 1)
    now[0] += 2 * LINE_EVERY_S
    lines.look()
    assert out.getvalue().splitlines() == [
        "training codebooks: 0 of 1, for 5 s",
        "training codebooks: 0 of 1, for 10 s",
    ]


def test_a_step_that_has_just_begun_is_not_told_of_because_the_last_line_is_old() -> None:
    """`encoding frames: 0 of 40, for 0 s`."""
    out, now = io.StringIO(), [0.0]
    lines = ProgressLines(out, lambda: now[0])
    now[0] = 2 * LINE_EVERY_S
    lines.tell("sample", 1, 2)
    now[0] += 0.9 * LINE_EVERY_S
    lines.tell("encode", 0, 40)
    now[0] += 0.2 * LINE_EVERY_S
    lines.look()
    assert out.getvalue() == "sampling frames: 1 of 2\n"


def test_the_thread_that_looks_ends_with_the_stages(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(progress, "LINE_EVERY_S", 0.05)
    monkeypatch.setattr(progress, "LOOK_EVERY_S", 0.01)
    with pytest.raises(KeyboardInterrupt), progress_bar(lines=True) as tell:
        tell("codebooks", 0, 1)
        end_s = time.monotonic() + 20
        while not (told := capsys.readouterr().err) and time.monotonic() < end_s:
            time.sleep(0.01)
        assert told.startswith("training codebooks: 0 of 1, for 0 s")
        raise KeyboardInterrupt
    assert not [thread for thread in threading.enumerate() if thread.name == "progress"]
