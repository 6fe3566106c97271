"""Connections that break between real processes: the client takes the session up again and plays to the end."""

from __future__ import annotations

import json
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from cags_bench.bundles import cached_bundle
from cags_bench.demo.processes import Process, ProcessGroup
from cags_encoder import EncodeSettings

SIZE = ("--width", "96", "--height", "72", "--restore", "none")


@pytest.fixture(scope="module")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    settings = EncodeSettings(frames=180, train_splats=4096, lod_order="paper")
    return cached_bundle("procedural:size=800,frames=60", str(tmp_path_factory.mktemp("bundles")), settings)


def until(what: Callable[[], bool], seconds: float = 60.0) -> None:
    deadline = time.monotonic() + seconds
    while not what():
        assert time.monotonic() < deadline, "it did not come about"
        time.sleep(0.02)


def plays(server: Process) -> bool:
    """Whether a client of the server has joined."""
    return "joined" in server.log.read_text()


def outcome(client: Process, report: Path) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    assert client.handle.wait(60) == 0, client.last_words()
    lines = [json.loads(line) for line in report.read_text().splitlines()]
    return lines[:-1], lines[-1]


def watch(group: ProcessGroup, url: str, report: Path) -> Process:
    return group.start("cags_client", ["--url", url, *SIZE, "--json", str(report), "--start-delay-ms", "1500"])


def watched_pair(group: ProcessGroup, bundle: Path, report: Path) -> tuple[list[Process], Process]:
    """Two servers, and a client that knows both and watches the first."""
    servers = [group.start("cags_server", ["--bundle", str(bundle), "--port", "0", "--json"]) for _ in range(2)]
    urls = [f"ws://127.0.0.1:{server.ready()['port']}/stream" for server in servers]
    client = watch(group, ",".join(urls), report)
    until(lambda: plays(servers[0]))
    return servers, client


def test_a_link_that_is_killed_midway_is_replaced_and_the_play_goes_on(bundle: Path, tmp_path: Path) -> None:
    report = tmp_path / "frames.jsonl"
    with ProcessGroup(tmp_path) as group:
        server = group.start("cags_server", ["--bundle", str(bundle), "--port", "0", "--json"])
        to = f"127.0.0.1:{server.ready()['port']}"
        shaper = group.start("cags_shaper", ["--listen", "127.0.0.1:0", "--to", to, "--json"])
        port = shaper.ready()["port"]
        client = watch(group, f"ws://127.0.0.1:{port}/stream", report)
        until(lambda: plays(server))
        time.sleep(3.0)
        shaper.handle.send_signal(signal.SIGKILL)
        shaper.handle.wait(10)
        group.start("cags_shaper", ["--listen", f"127.0.0.1:{port}", "--to", to, "--json"]).ready()
        frames, summary = outcome(client, report)
    assert summary["reconnects"] == 1
    assert frames[-1]["frame"] == 179
    away = [f["frame"] for f in frames if f["missed"]]
    assert not frames[-1]["missed"], f"whole again at the end; missed {away}"
    assert all(f["lod_mean"] is not None for f in frames), "something is shown in every frame"


def test_another_server_takes_over_when_one_is_killed(bundle: Path, tmp_path: Path) -> None:
    report = tmp_path / "frames.jsonl"
    with ProcessGroup(tmp_path) as group:
        servers, client = watched_pair(group, bundle, report)
        time.sleep(3.0)
        servers[0].handle.send_signal(signal.SIGKILL)
        frames, summary = outcome(client, report)
        assert plays(servers[1])
    assert summary["reconnects"] == 1
    assert summary["away_ms"] < 2_000
    assert not frames[-1]["missed"]


def test_what_was_shown_before_an_error_is_kept(bundle: Path, tmp_path: Path) -> None:
    report, clip = tmp_path / "frames.jsonl", tmp_path / "clip.mp4"
    with ProcessGroup(tmp_path) as group:
        server = group.start("cags_server", ["--bundle", str(bundle), "--port", "0", "--json"])
        url = f"ws://127.0.0.1:{server.ready()['port']}/stream"
        outputs = ["--record", str(clip), "--json", str(report), "--reconnect-s", "0.3", "--startup-ms", "0"]
        client = group.start("cags_client", ["--url", url, *SIZE, *outputs])
        until(lambda: any(tmp_path.glob(".clip.mp4.*.part")) and plays(server))
        time.sleep(2.0)
        server.handle.send_signal(signal.SIGKILL)
        assert client.handle.wait(60) == 1
        (line,) = client.log.read_text().splitlines()
    assert "the connection was lost" in line
    *frames, summary = [json.loads(line) for line in report.read_text().splitlines()]
    assert len(frames) == summary["frames"] > 0
    assert clip.stat().st_size > 1000


def test_a_full_server_is_skipped_at_the_start(bundle: Path, tmp_path: Path) -> None:
    report = tmp_path / "frames.jsonl"
    with ProcessGroup(tmp_path) as group:
        start = ["--bundle", str(bundle), "--port", "0", "--json"]
        servers = [group.start("cags_server", [*start, *limit]) for limit in (["--max-clients", "1"], [])]
        urls = [f"ws://127.0.0.1:{server.ready()['port']}/stream" for server in servers]
        watch(group, urls[0], tmp_path / "other.jsonl")
        until(lambda: plays(servers[0]))
        brief = [*SIZE, "--duration", "0.5"]
        client = group.start("cags_client", ["--url", ",".join(urls), *brief, "--json", str(report)])
        _, summary = outcome(client, report)
        assert plays(servers[1])
        alone = group.start("cags_client", ["--url", urls[0], *brief])
        assert alone.handle.wait(60) == 1
        assert "1 clients are here already; try again later" in alone.last_words()
    assert summary["reconnects"] == 0


def test_a_server_that_shuts_down_in_order_hands_its_clients_over(bundle: Path, tmp_path: Path) -> None:
    report = tmp_path / "frames.jsonl"
    with ProcessGroup(tmp_path) as group:
        servers, client = watched_pair(group, bundle, report)
        time.sleep(2.0)
        servers[0].handle.send_signal(signal.SIGTERM)
        frames, summary = outcome(client, report)
        assert servers[0].handle.wait(20) == 0
    assert summary["reconnects"] == 1
    assert not frames[-1]["missed"]
