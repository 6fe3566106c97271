"""What the doctor says of machines that are well, odd and broken."""

from __future__ import annotations

import json
import socket
from pathlib import Path

import pytest

from cags_bench.doctor import cli, machine, parts
from cags_bench.doctor.findings import Verdict, fine, missing, note
from cags_bench.doctor.timings import SizeTimes, Timings, advise


def test_an_old_python_is_missing_what_is_needed() -> None:
    assert machine.python_version((3, 9)).verdict is Verdict.MISSING
    assert machine.python_version((3, 12)).verdict is Verdict.OK


def test_one_core_is_noted() -> None:
    assert machine.cores(1).verdict is Verdict.NOTE
    assert machine.cores(2).verdict is Verdict.OK


@pytest.mark.parametrize(
    ("cpuinfo", "found"), [("flags: sse2 avx2 avx512f", "AVX512F"), ("flags: avx2", "AVX2"), ("", "none known")]
)
def test_the_widest_vectors_are_named(cpuinfo: str, found: str) -> None:
    assert machine.vectors(cpuinfo).found == found


@pytest.mark.parametrize(
    ("meminfo", "verdict"),
    [
        ("MemAvailable:   16777216 kB", Verdict.OK),
        ("MemAvailable:   1000 kB", Verdict.NOTE),
        ("MemAvailable: lots", Verdict.NOTE),
        ("", Verdict.NOTE),
    ],
)
def test_memory(meminfo: str, verdict: Verdict) -> None:
    assert machine.memory(meminfo).verdict is verdict


def test_the_cache_need_not_exist_yet(tmp_path: Path) -> None:
    assert str(tmp_path / "a" / "b") in machine.disk(tmp_path / "a" / "b").found


def test_congestion_control() -> None:
    assert machine.congestion_control("bbr\n").verdict is Verdict.OK
    assert "bbr" in machine.congestion_control("cubic").remedy
    assert machine.congestion_control("").verdict is Verdict.NOTE


def test_a_port_in_use_is_noted_with_its_way_out() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        found = machine.free_port(taken.getsockname()[1], "tests")
    assert found.verdict is Verdict.NOTE
    assert "--port" in found.remedy


def test_no_browser_is_no_obstacle() -> None:
    assert machine.browser(None).verdict is Verdict.NOTE


def test_every_part_is_tried_here() -> None:
    found = {finding.matter: finding for finding in parts.part_findings()}
    for matter in ("H.264", "Draco", "k-means"):
        assert found[matter].verdict is Verdict.OK, found[matter]
    assert found["CUDA"].verdict is not Verdict.MISSING


def test_kernels_of_another_version_are_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("cags_kernels.library")
    if parts.kernels().verdict is not Verdict.OK:
        pytest.skip("no native kernels here")
    monkeypatch.setattr(parts, "version", {"cags-stream": "0.2.0", "cags-kernels": "0.1.0"}.__getitem__)
    found = parts.kernels()
    assert found.verdict is Verdict.MISSING
    assert "0.1.0, where cags-stream is 0.2.0" in found.found


def test_a_part_that_fails_is_a_finding_with_a_remedy() -> None:
    def broken() -> object:
        raise ImportError("libx264.so: no such file\nmore")

    found = parts.guarded("H.264", broken)  # type: ignore[arg-type]
    assert (found.verdict, found.found) == (Verdict.MISSING, "libx264.so: no such file")
    assert "pip install" in found.remedy


def timed(*totals: tuple[int, float, float]) -> Timings:
    sizes = tuple(SizeTimes(w, w * 3 // 4, raster, 0.0, rest) for w, raster, rest in totals)
    return Timings("cpu", 60_000, 2, 5.0, 2.0, sizes)


def test_the_largest_picture_that_fits_is_recommended() -> None:
    assert "--width 800 --height 600 --restore affine" in advise(timed((400, 3, 2), (800, 9, 6), (1600, 40, 20))).flags
    assert "--width 800 --height 600 --restore none" in advise(timed((400, 3, 2), (800, 18, 9), (1600, 40, 20))).flags
    hopeless = advise(timed((320, 900, 20)))
    assert "--exactness fast" in hopeless.flags
    assert "out of reach" in hopeless.reason


def test_the_command_is_well_and_speaks_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["--quick", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["healthy"] is True
    assert said["timings"] is None
    assert {"Python", "kernels", "H.264"} <= {finding["matter"] for finding in said["findings"]}


def test_a_missing_part_makes_the_command_fail(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def sick() -> list[object]:
        return [fine("a", "x"), note("b", "y", "do y"), missing("c", "gone", "fetch c")]

    monkeypatch.setattr(parts, "part_findings", sick)
    assert cli.main([]) == 1
    said = capsys.readouterr().out
    assert "MISSING" in said
    assert "fetch c" in said


@pytest.mark.parametrize("columns", ["20", "69", "70", "200"])
def test_every_width_of_a_terminal_shows_what_to_do(
    columns: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    remedy = "fetch"
    monkeypatch.setattr(parts, "part_findings", lambda: [missing("part", "gone", remedy)])
    monkeypatch.setenv("COLUMNS", columns)
    assert cli.main(["--quick"]) == 1
    said = capsys.readouterr().out
    assert all(word in said for word in ("MISSING", "part", "gone", remedy))
    assert ("┃" in said) == (int(columns) >= cli.TABLE_COLUMNS)


def test_wrong_use_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["--threads", "-2"]) == 2
    assert "threads" in capsys.readouterr().err
