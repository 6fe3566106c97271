"""Server, shaper and client as three operating-system processes."""

import json
import os
import signal
import socket
import time
from pathlib import Path

import pytest

from cags_bench.bundles import cached_bundle
from cags_bench.demo.processes import ProcessGroup
from cags_encoder import EncodeSettings
from support.processes import assert_one_clear_line, run_module

SCENE = "procedural:size=1500,frames=10"
SIZE = ("--width", "160", "--height", "120")


@pytest.fixture(scope="module")
def bundle(tmp_path_factory) -> Path:
    return cached_bundle(
        SCENE, str(tmp_path_factory.mktemp("bundles")), EncodeSettings(frames=10, train_splats=4096, lod_order="paper")
    )


@pytest.fixture(scope="module")
def long_bundle(tmp_path_factory) -> Path:
    """Sixteen seconds at a frame a second: nothing but a signal ends its play early."""
    settings = EncodeSettings(frames=16, fps=1, lod_order="paper", train_splats=4096)
    return cached_bundle(SCENE, str(tmp_path_factory.mktemp("bundles")), settings)


def frames_and_summary(path: Path) -> tuple[list[dict], dict]:
    lines = [json.loads(line) for line in path.read_text().splitlines()]
    return lines[:-1], lines[-1]


def test_a_scene_streams_through_three_processes(bundle, tmp_path):
    report = tmp_path / "frames.jsonl"
    with ProcessGroup(tmp_path) as group:
        server_process = group.start("cags_server", ["--bundle", str(bundle), "--port", "0", "--json"])
        server = server_process.ready()
        shaper_process = group.start(
            "cags_shaper",
            [
                "--listen",
                "127.0.0.1:0",
                "--to",
                f"127.0.0.1:{server['port']}",
                "--trace",
                "generated:steady-30",
                "--json",
            ],
        )
        shaper = shaper_process.ready()
        done = run_module(
            "cags_client",
            *("--url", f"ws://127.0.0.1:{shaper['port']}/stream", "--truth", str(bundle), "--json", str(report)),
            *("--save", str(tmp_path / "pictures"), *SIZE),
        )
        assert done.returncode == 0, done.stderr
        pids = {server_process.handle.pid, shaper_process.handle.pid, os.getpid()}
        assert len(pids) == 3
    frames, summary = frames_and_summary(report)
    assert summary["frames"] == len(frames) >= 1
    assert summary["bytes_tiles"] > 0
    assert all(frame["psnr_distorted_db"] > 10 for frame in frames)
    assert len(list((tmp_path / "pictures").glob("*.png"))) == len(frames)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_play_keeps_what_it_has_shown(number, long_bundle, tmp_path):
    report, clip = tmp_path / "frames.jsonl", tmp_path / "clip.mp4"
    with ProcessGroup(tmp_path) as group:
        server = group.start("cags_server", ["--bundle", str(long_bundle), "--port", "0", "--json"])
        url = f"ws://127.0.0.1:{server.ready()['port']}/stream"
        client = group.start("cags_client", ["--url", url, "--json", str(report), "--record", str(clip), *SIZE])
        deadline = time.monotonic() + 60
        while "joined" not in server.log.read_text():
            assert time.monotonic() < deadline
            time.sleep(0.1)
        time.sleep(2)
        client.handle.send_signal(number)
        assert client.handle.wait(30) == 128 + number
        left = server.log.read_text()
    frames, summary = frames_and_summary(report)
    assert summary["frames"] == len(frames)
    assert 0 < len(frames) < 16
    assert clip.stat().st_size > 0
    assert client.last_words() == f"cags-client: ended by {number.name} after {len(frames)} frames"
    assert "left (bye" in left


def test_late_and_rare_references_help(tmp_path):
    """A slow link, moving parts, a reference for every third frame; ten frames a second, for machines that are busy.
    What is held by a frame, and from where it was predicted to be seen, hangs on the machine: frame by frame
    ``tests/sim/test_rare_references.py`` looks at it.
    """
    scene = "procedural:size=12000,frames=30,seed=3"
    settings = EncodeSettings(frames=30, fps=10, train_splats=4096, lod_order="paper")
    bundle = cached_bundle(scene, str(tmp_path / "bundles"), settings)
    report = tmp_path / "frames.jsonl"
    with ProcessGroup(tmp_path) as group:
        server = group.start(
            "cags_server", ["--bundle", str(bundle), "--port", "0", "--reference-every", "3", "--json"]
        ).ready()
        link = ["--listen", "127.0.0.1:0", "--to", f"127.0.0.1:{server['port']}", "--delay-ms", "60", "--json"]
        shaper = group.start("cags_shaper", [*link, "--trace", "generated:steady-2"]).ready()
        url = f"ws://127.0.0.1:{shaper['port']}/stream"
        done = run_module("cags_client", "--url", url, "--truth", str(bundle), "--json", str(report), *SIZE)
        assert done.returncode == 0, done.stderr
    frames, _ = frames_and_summary(report)
    restored = [f for f in frames if "correction" in f["effects"]]
    assert restored, "no reference came in time to be of use"
    gains = [f["psnr_restored_db"] - f["psnr_distorted_db"] for f in restored]
    assert sum(gains) / len(gains) > 0


def test_a_server_that_goes_away_is_named_and_the_client_ends(bundle, tmp_path):
    with ProcessGroup(tmp_path) as group:
        server = group.start("cags_server", ["--bundle", str(bundle), "--port", "0", "--json"])
        port = server.ready()["port"]
        client = group.start(
            "cags_client",
            [
                "--url",
                f"ws://127.0.0.1:{port}/stream",
                "--json",
                str(tmp_path / "r.jsonl"),
                *("--start-delay-ms", "9000", "--reconnect-s", "0.5"),
                *SIZE,
            ],
        )
        wait_until_joined(server.log)
        server.handle.send_signal(signal.SIGKILL)
        assert client.handle.wait(30) == 1
        lines = [line for line in client.log.read_text().splitlines() if line.strip()]
        assert len(lines) == 1
        assert "lost" in lines[0] or "gone" in lines[0]
    assert not (tmp_path / "r.jsonl").exists()


def wait_until_joined(log: Path) -> None:
    import time

    for _ in range(300):
        if "joined" in log.read_text():
            return
        time.sleep(0.1)
    raise AssertionError(f"no client joined: {log.read_text()}")


def test_a_server_ends_cleanly_when_asked(bundle, tmp_path):
    with ProcessGroup(tmp_path) as group:
        server = group.start("cags_server", ["--bundle", str(bundle), "--port", "0", "--json"])
        server.ready()
        server.handle.send_signal(signal.SIGTERM)
        assert server.handle.wait(20) == 0


def test_a_port_in_use_is_named(bundle):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        assert_one_clear_line(
            run_module("cags_server", "--bundle", str(bundle), "--port", str(port)), str(port), "in use"
        )
        assert_one_clear_line(
            run_module(
                "cags_shaper", "--listen", f"127.0.0.1:{port}", "--to", "127.0.0.1:1", "--trace", "generated:steady-30"
            ),
            str(port),
            "in use",
        )


def test_nobody_listening_is_named():
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    done = run_module("cags_client", "--url", f"ws://127.0.0.1:{port}/stream")
    assert_one_clear_line(done, f"ws://127.0.0.1:{port}/stream", code=1)


@pytest.mark.parametrize(
    ("module", "arguments", "named"),
    [
        ("cags_server", ["--bundle", "no-such-bundle"], "no-such-bundle"),
        ("cags_encoder", ["no-such-scene.ply", "out"], "no-such-scene.ply"),
        ("cags_encoder", ["procedural:size=none", "out"], "size"),
        (
            "cags_shaper",
            ["--listen", "127.0.0.1:0", "--to", "127.0.0.1:1", "--trace", "no-such-trace"],
            "no-such-trace",
        ),
        ("cags_client", ["--url", "http://127.0.0.1:1/"], "http://127.0.0.1:1/"),
        ("cags_bench", ["stream", "--scene", "no-such-scene", "--json"], "no-such-scene"),
        ("cags_bench", ["stream", "--trace", "no-such-trace", "--scene", SCENE, "--frames", "2"], "no-such-trace"),
        ("cags_bench", ["stream", "--poses", "no-such-poses", "--scene", SCENE, "--frames", "2"], "no-such-poses"),
        ("cags_bench", ["no-such-subcommand"], "no-such-subcommand"),
    ],
)
def test_bad_input_is_one_clear_line(module, arguments, named, tmp_path):
    done = run_module(module, *arguments, cwd=tmp_path)
    assert_one_clear_line(done, named)
    assert not (tmp_path / "out").exists(), "nothing half-written"
