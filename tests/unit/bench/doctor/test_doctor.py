"""What the doctor says of machines that are well, odd and broken."""

from __future__ import annotations

import contextlib
import json
import socket
import threading
from argparse import ArgumentParser
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import pytest

from cags_bench.doctor import cli, machine, parts
from cags_bench.doctor import timings as timing
from cags_bench.doctor.findings import Verdict, fine, missing, note
from cags_bench.doctor.timings import SizeTimes, Timings, advise
from cags_client.settings import ClientSettings
from cags_common.correction import Reference
from cags_common.raster import RenderOptions
from cags_common.settings import add_settings, load_settings
from cags_kernels import native_available
from cags_server.settings import ServerSettings
from support.gpu import needs_adapter, software_passes
from support.raster_scenes import camera, random_splats


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
        found = machine.free_port(taken.getsockname()[1], "cags-shaper")
    assert found.verdict is Verdict.MISSING
    assert "--listen" in found.remedy


@pytest.mark.parametrize(
    ("path", "body"), [("/healthz", b'{"status": "ready"}'), ("/", b"<html><title>cags-stream</title>")]
)
def test_a_port_where_a_command_of_ours_answers_is_well(path: str, body: bytes) -> None:
    class Answer(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200 if self.path == path else 404)
            self.end_headers()
            self.wfile.write(body if self.path == path else b"")

        def log_message(self, *_: object) -> None:
            """Nothing to standard error."""

    with ThreadingHTTPServer(("127.0.0.1", 0), Answer) as running:
        threading.Thread(target=running.serve_forever, daemon=True).start()
        found = machine.free_port(running.server_port, "cags-server")
        running.shutdown()
    assert (found.verdict, found.found) == (Verdict.OK, "used by cags-stream (default of cags-server)")


@pytest.mark.parametrize(
    "answer", [b"", b"SSH-2.0-x\r\n", b'HTTP/1.0 200 OK\r\n\r\n["status"]', b"HTTP/1.0 200 OK\r\n\r\n<p>"]
)
def test_a_stranger_on_a_port_is_none_of_ours(answer: bytes) -> None:
    with socket.create_server(("127.0.0.1", 0)) as stranger:

        def reply() -> None:
            with contextlib.suppress(OSError):  # nobody asks a second time, and the socket is closed
                for _ in range(2):
                    line, _ = stranger.accept()
                    with line:
                        line.recv(1000)
                        line.sendall(answer)

        threading.Thread(target=reply, daemon=True).start()
        assert not machine.is_ours(stranger.getsockname()[1])


def test_a_busy_machine_is_noted_before_it_is_measured() -> None:
    assert machine.load(0.3, 2).verdict is Verdict.OK
    assert "when the machine is idle" in machine.load(1.9, 2).remedy


def test_no_browser_is_no_obstacle() -> None:
    assert machine.browser(None).verdict is Verdict.NOTE


def test_every_part_is_tried_here() -> None:
    found = {finding.matter: finding for finding in parts.part_findings()}
    for matter in ("H.264", "Draco", "k-means"):
        assert found[matter].verdict is Verdict.OK, found[matter]
    assert found["GPU"].verdict is not Verdict.MISSING


def test_kernels_of_another_version_are_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("cags_kernels.library")
    if parts.kernels().verdict is not Verdict.OK:
        pytest.skip("no native kernels here")
    monkeypatch.setattr(parts, "version", {"cags-stream": "0.2.0", "cags-kernels": "0.1.0"}.__getitem__)
    found = parts.kernels()
    assert found.verdict is Verdict.MISSING
    assert "0.1.0, but cags-stream has version 0.2.0" in found.found


def test_a_part_that_fails_is_a_finding_with_a_remedy() -> None:
    def broken() -> object:
        raise ImportError("libx264.so: no such file\nmore")

    found = parts.guarded("H.264", broken)  # type: ignore[arg-type]
    assert (found.verdict, found.found) == (Verdict.MISSING, "libx264.so: no such file")
    assert "pip install" in found.remedy


def timed(*totals: tuple[int, float, float]) -> Timings:
    sizes = tuple(SizeTimes(w, w * 3 // 4, raster, rest - 2.0, 2.0) for w, raster, rest in totals)
    return Timings("cpu", 30_000, 2, 5.0, 1.0, 1.0, sizes)


def test_the_largest_picture_that_is_drawn_and_corrected_in_time_is_recommended() -> None:
    best = advise(timed((400, 3, 10), (640, 12, 20), (800, 19, 28), (1600, 70, 90)))
    assert best.client == "--width 640 --height 480 --resolution full --threads 2"
    assert "a frame takes 12 ms, a corrected frame 32 ms" in best.reason
    slow = advise(timed((400, 18, 40), (800, 30, 50)))
    assert slow.client == "--width 400 --height 300 --resolution auto --threads 2"
    hopeless = advise(timed((320, 900, 20)))
    assert "--restore none --exactness fast" in hopeless.client
    assert "too slow for 30 frames per second" in hopeless.reason


def test_every_stage_of_a_frame_and_of_a_reference_is_timed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(timing, "NATIVE_SPLATS", 500)
    monkeypatch.setattr(timing, "READABLE_SPLATS", 500)
    monkeypatch.setattr(timing, "SIZES", ((64, 48), (96, 72)))
    monkeypatch.setattr(timing, "READABLE_SIZES", ((64, 48),))
    monkeypatch.setenv("CAGS_GPU_ADAPTER", "no such adapter")
    timings = timing.measure(1)
    assert (timings.splats, timings.threads, timings.sizes[0].width) == (500, 1, 64)
    assert min(timings.reference_ms, timings.mirror_ms, timings.encode_ms) > 0
    for size in timings.sizes:
        assert size.total_ms == size.raster_ms + size.correct_ms + size.own_ms
        assert min(size.raster_ms, size.correct_ms, size.own_ms) > 0
        assert size.gpu_draw_ms is size.gpu_total_ms is timings.gpu_reference_ms is None


@pytest.mark.parametrize(
    ("reference_ms", "flags"), [(10, ""), (25, " --reference-every 2"), (50, " --reference-every 3")]
)
def test_references_are_rarer_where_they_take_the_server_too_long(reference_ms: float, flags: str) -> None:
    timings = replace(timed((400, 3, 10)), reference_ms=reference_ms)
    assert advise(timings).server == "--render-threads 2" + flags


def test_the_flags_that_are_recommended_are_taken_by_the_commands(capsys: pytest.CaptureFixture[str]) -> None:
    for timings in (timed((400, 3, 10)), timed((400, 18, 40)), replace(timed((320, 900, 20)), reference_ms=90)):
        advice = advise(timings)
        parser = ArgumentParser()
        add_settings(parser, ClientSettings)
        load_settings(ClientSettings, parser.parse_args(advice.client.split()))
        parser = ArgumentParser()
        add_settings(parser, ServerSettings)
        load_settings(ServerSettings, parser.parse_args(advice.server.split()))


def test_kernels_that_are_not_there_are_missing_with_the_way_to_them(monkeypatch: pytest.MonkeyPatch) -> None:
    import cags_kernels

    monkeypatch.setattr(cags_kernels, "native_available", lambda: False)
    monkeypatch.setattr(cags_kernels, "why_unavailable", lambda: "libcags.so: no such file")
    found = parts.kernels()
    assert found.verdict is Verdict.MISSING
    assert "libcags.so" in found.found
    assert "pip install --force-reinstall ./kernels" in found.remedy


def test_the_command_is_well_and_speaks_json(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(machine, "PORTS", {0: "cags-server"})  # others may run here, and the kernels may be left out
    well = native_available()
    assert cli.main(["--quick", "--json"]) == (0 if well else 1)
    said = json.loads(capsys.readouterr().out)
    assert said["healthy"] is well
    assert said["timings"] is None
    assert {"Python", "kernels", "H.264"} <= {finding["matter"] for finding in said["findings"]}


def test_a_missing_part_makes_the_command_fail(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def sick() -> list[object]:
        return [fine("a", "x"), note("b", "y", "do y"), missing("H.264", "gone", "fetch it")]

    monkeypatch.setattr(parts, "part_findings", sick)
    assert cli.main([]) == 1
    said = capsys.readouterr().out
    assert "MISSING" in said
    assert "fetch it" in said
    assert "milliseconds" not in said  # nothing can be timed without


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
    assert cli.main(["--threads", "-2"]) == cli.main(["--threads", "0"]) == 2
    assert "threads" in capsys.readouterr().err


@needs_adapter
def test_the_graphics_processor_is_named_with_driver_and_limits_and_timed() -> None:
    with software_passes():
        found = parts.gpu()
        gpu = timing._on_gpu(random_splats(100), random_splats(100, seed=1))
        assert gpu is not None
        there = camera(48, 36)
        picture = Reference(np.full((36, 48, 3), 0.5, np.float32), there, picture=True)
        times = timing._with_gpu(SizeTimes(64, 48, 1.0, 1.0, 1.0), gpu, there.pose, picture)
        assert timing._gpu_reference_ms(gpu, there, RenderOptions(contribution=True)) > 0
    assert found.verdict is Verdict.OK
    assert gpu.adapter in found.found
    assert "MiB" in found.found
    assert "timestamps" in found.found
    assert times.gpu_draw_ms is not None
    assert times.gpu_total_ms is not None
    assert min(times.gpu_draw_ms, times.gpu_total_ms) > 0


def test_where_there_is_one_what_is_recommended_is_for_it() -> None:
    cpu = timed((400, 18, 40), (1600, 70, 90))
    sizes = tuple(replace(size, gpu_draw_ms=1.0, gpu_total_ms=2.0) for size in cpu.sizes)
    best = advise(replace(cpu, reference_ms=90, sizes=sizes, adapter="a card", gpu_reference_ms=2.0))
    assert best.client == "--width 1600 --height 1200 --resolution full --threads 2"
    assert best.server == "--render-threads 2"
    assert "on the GPU a frame takes 1 ms, a corrected frame 2 ms" in best.reason


def test_without_one_the_reason_is_noted_and_nothing_is_timed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CAGS_GPU_ADAPTER", "no such adapter")
    found = parts.gpu()
    assert found.verdict is Verdict.NOTE
    assert found.remedy == "not needed: frames are drawn by the CPU"
    assert timing._on_gpu(random_splats(10), random_splats(10)) is None
