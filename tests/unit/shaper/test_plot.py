import io
import json

import pytest

from cags_common.errors import TraceError
from cags_shaper.cli import main
from cags_shaper.link import Link, LinkSettings
from cags_shaper.log import LogWriter
from cags_shaper.settings import ShaperSettings
from cags_shaper.trace import open_trace


class Direction:
    """As much of a shaped direction as a log looks at."""

    def __init__(self, link):
        self.link, self.time_us = link, 0

    def now_us(self):
        return self.time_us


def written_log(trace, settings=None):
    file = io.StringIO()
    writer = LogWriter(file, ShaperSettings())
    down, up = Direction(Link(trace, settings)), Direction(Link(None, settings))
    for step in range(1, 20):
        for direction in (down, up):
            direction.time_us = step * 100_000
            direction.link.push(direction.time_us, b"x" * 1000)
            direction.link.pop_due(direction.time_us)
        writer.sample("down", down)
        writer.sample("up", up)
    return file.getvalue()


@pytest.mark.parametrize("trace", ["generated:steady-10", None])
def test_a_log_is_drawn_beside_itself(tmp_path, capsys, trace):
    log = tmp_path / "s.jsonl"
    log.write_text(written_log(open_trace(trace) if trace else None) + '{"cut')
    assert main(["--plot", str(log)]) == 0
    assert capsys.readouterr().out.strip() == str(tmp_path / "s.png")
    assert (tmp_path / "s.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("trace", "cap_mbps", "allowed_mbps"),
    [(None, None, None), (None, 4, 4), ("generated:steady-10", 4, 4), ("generated:steady-10", 40, 10)],
)
def test_the_capacity_of_a_log_is_what_trace_and_cap_allow(trace, cap_mbps, allowed_mbps):
    settings = LinkSettings(cap_bps=cap_mbps and cap_mbps * 1e6)
    _, *rows = map(json.loads, written_log(open_trace(trace) if trace else None, settings).splitlines())
    down = [row["capacity_bytes"] for row in rows if row["direction"] == "down"]
    if allowed_mbps is None:
        assert set(down) == {None}
    else:
        assert sum(down) == pytest.approx(allowed_mbps * 1e6 / 8 * 1.9, rel=0.01)


@pytest.mark.parametrize("text", ["", "{}\n", "[]\n", "hello\n", '{"log": "other", "interval_us": 100000}\n'])
def test_what_is_no_log_is_refused(tmp_path, capsys, text):
    log = tmp_path / "s.jsonl"
    log.write_text(text)
    assert main(["--plot", str(log)]) == 1
    assert "s.jsonl: is no log" in capsys.readouterr().err


def test_a_cap_that_was_lifted_is_drawn_as_long_as_it_held(tmp_path):
    log = tmp_path / "s.jsonl"
    header = written_log(None).splitlines()[0]
    rows = [SAMPLE | {"t_us": n, "capacity_bytes": allowed} for n, allowed in ((1, None), (2, 10), (3, None))]
    log.write_text("\n".join([header, *map(json.dumps, rows), ""]))
    assert main(["--plot", str(log)]) == 0


SAMPLE = {"t_us": 1, "direction": "down", "capacity_bytes": None, "delivered_bytes": 0, "queued_bytes": 0}


@pytest.mark.parametrize("row", ['{"t_us": 1}', "5", json.dumps(SAMPLE | {"direction": "left"}), "{}"])
def test_a_row_that_is_no_sample_is_refused(tmp_path, capsys, row):
    log = tmp_path / "s.jsonl"
    header = written_log(None).splitlines()[0]
    log.write_text(f"{header}\n{json.dumps(SAMPLE)}\n{row}\n")
    assert main(["--plot", str(log)]) == 1
    assert capsys.readouterr().err == (
        f"cags-shaper: {log}, line 3: is no sample of cags-shaper; give a file written by cags-shaper --log\n"
    )
    assert not (tmp_path / "s.png").exists()


def test_a_picture_does_not_take_the_place_of_its_log(tmp_path, capsys):
    log = tmp_path / "s.png"
    log.write_text(written_log(None))
    assert main(["--plot", str(log)]) == 1
    assert "s.png: its picture would take its place; give the log another name" in capsys.readouterr().err
    assert log.read_text() == written_log(None)


def test_a_missing_log_is_named(tmp_path):
    from cags_shaper.plot import read_log

    with pytest.raises(TraceError, match="nowhere"):
        read_log(tmp_path / "nowhere")


@pytest.mark.parametrize("path", ["/", "."])
def test_a_folder_is_no_log(capsys, path):
    assert main(["--plot", path]) == 1
    assert f"{path}: cannot be read" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("content", "what"),
    [
        (b"", "is no log of cags-shaper (it is empty)"),
        (b"hello\n", "is no log of cags-shaper"),
        (b"\xff\n", "is no log of cags-shaper (byte 0 is not UTF-8)"),
    ],
)
def test_what_is_no_log_is_told_with_what_is(tmp_path, capsys, content, what):
    log = tmp_path / "s.jsonl"
    log.write_bytes(content)
    assert main(["--plot", str(log)]) == 1
    assert capsys.readouterr().err == f"cags-shaper: {log}: {what}; give a file written by cags-shaper --log\n"
