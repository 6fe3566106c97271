"""Progress if stderr is not a terminal."""

import io

import pytest

from cags_encoder.execution.progress import LINE_EVERY_S, progress_bar, progress_lines


def test_a_line_now_and_then() -> None:
    out, now = io.StringIO(), [0.0]
    tell = progress_lines(out, lambda: now[0])
    for frame in range(1, 101):
        now[0] += LINE_EVERY_S / 10
        tell("encode", frame, 100)
    lines = out.getvalue().splitlines()
    assert lines[0] == "encoding frames: 10 of 100" and len(lines) == 10


def test_what_is_done_at_once_says_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    with progress_bar(lines=True) as tell:
        tell("encode", 1, 1)
    assert capsys.readouterr() == ("", "")
