"""The `scale` profile of the compose file as plain processes: an S3 store, two servers, nginx, several clients."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
import time
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from cags_bench.demo.processes import Process, ProcessGroup
from support.processes import free_port

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[3]
CLIENTS = 4
DEADLINE_S = 60


def fetch(url: str) -> str:
    with urllib.request.urlopen(url, timeout=2) as response:
        return str(response.read().decode())


def wait_until_up(url: str) -> None:
    deadline = time.monotonic() + DEADLINE_S
    while True:
        try:
            fetch(url)
        except urllib.error.HTTPError:
            return  # it answers
        except OSError:
            assert time.monotonic() < deadline, f"{url} does not answer"
            time.sleep(0.1)
        else:
            return


@pytest.fixture
def store(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """URL of an empty bucket in an S3 store of its own."""
    for package in ("moto", "s3fs"):
        pytest.importorskip(package, reason="an S3 store for the test: pip install 'moto[server]' s3fs")
    port = free_port()
    settings = {"AWS_ACCESS_KEY_ID": "test", "AWS_SECRET_ACCESS_KEY": "test", "AWS_DEFAULT_REGION": "us-east-1"}
    settings |= {
        "FSSPEC_S3_ENDPOINT_URL": f"http://127.0.0.1:{port}",
        "FSSPEC_S3_KEY": "test",
        "FSSPEC_S3_SECRET": "test",
    }
    for name, value in settings.items():
        monkeypatch.setenv(name, value)
    with (tmp_path / "store.log").open("w") as log:
        running = subprocess.Popen([sys.executable, "-m", "moto.server", "-p", str(port)], stdout=log, stderr=log)
    try:
        wait_until_up(f"http://127.0.0.1:{port}/moto-api/")
        request = urllib.request.Request(f"http://127.0.0.1:{port}/bundles", method="PUT")
        urllib.request.urlopen(request, timeout=5).close()
        yield "s3://bundles"
    finally:
        running.terminate()
        running.wait()


@pytest.fixture
def group(tmp_path: Path) -> Iterator[ProcessGroup]:
    with ProcessGroup(tmp_path) as running:
        yield running


def serve(group: ProcessGroup, bundle: str) -> tuple[Process, int]:
    process = group.start("cags_server", ["--bundle", bundle, "--port", "0", "--json"])
    return process, int(process.ready()["port"])


@pytest.fixture
def balance(tmp_path: Path) -> Iterator[Any]:
    """Starts nginx with the shipped configuration in front of two ports; returns its own."""
    nginx = shutil.which("nginx") or shutil.which("nginx", path="/usr/sbin")
    if nginx is None:
        pytest.skip("no nginx here; apt-get install nginx-light")
    running: list[subprocess.Popen[bytes]] = []

    def start(first: int, second: int) -> int:
        port = free_port()
        text = (ROOT / "deploy/nginx/nginx.conf").read_text(encoding="utf-8")
        text = text.replace("server-a:8765", f"127.0.0.1:{first}").replace("server-b:8765", f"127.0.0.1:{second}")
        text = text.replace("listen 8080", f"listen 127.0.0.1:{port}").replace("/tmp/", f"{tmp_path}/")
        text = text.replace("worker_processes auto", "worker_processes 1").replace(
            "/dev/stderr", f"{tmp_path}/nginx.log"
        )
        (tmp_path / "nginx.conf").write_text(text, encoding="utf-8")
        running.append(subprocess.Popen([nginx, "-c", str(tmp_path / "nginx.conf"), "-g", "daemon off;"]))
        wait_until_up(f"http://127.0.0.1:{port}/healthz")
        return port

    yield start
    for process in running:
        process.terminate()
        process.wait()


Watch = Callable[[int, Path], subprocess.Popen[str]]


@pytest.fixture
def watch() -> Iterator[Watch]:
    """Starts a client at a port that writes a report; none outlives the test."""
    running: list[subprocess.Popen[str]] = []

    def start(port: int, report: Path) -> subprocess.Popen[str]:
        arguments = ["--url", f"ws://127.0.0.1:{port}/stream", "--width", "160", "--height", "120"]
        arguments += ["--json", str(report), "--threads", "1", "--restore", "none"]
        command = [sys.executable, "-m", "cags_client", *arguments]
        running.append(subprocess.Popen(command, stderr=subprocess.PIPE, text=True))
        return running[-1]

    yield start
    for process in running:
        process.kill()
        process.communicate()


def finished(client: subprocess.Popen[str], report: Path) -> dict[str, Any]:
    _, said = client.communicate(timeout=120)
    assert client.returncode == 0, said
    return dict(json.loads(report.read_text(encoding="utf-8").splitlines()[-1]))


def metric(port: int, series: str) -> int:
    found = re.search(rf"^{re.escape(series)} (\S+)$", fetch(f"http://127.0.0.1:{port}/metrics"), re.MULTILINE)
    assert found
    return int(float(found.group(1)))


def joined(port: int) -> int:
    return metric(port, "cags_sessions_total")


def test_two_servers_on_one_store_share_the_clients_and_one_may_die(
    store: str, group: ProcessGroup, balance: Any, watch: Watch, tmp_path: Path
) -> None:
    bundle = f"{store}/scene"
    encode = [sys.executable, "-m", "cags_encoder", "procedural:size=1500,frames=15", bundle]
    encoded = subprocess.run(encode, capture_output=True, text=True, check=False)
    assert encoded.returncode == 0, encoded.stderr
    (first, port_a), (_, port_b) = serve(group, bundle), serve(group, bundle)
    port = balance(port_a, port_b)

    clients = [(watch(port, report), report) for report in (tmp_path / f"client{k}.jsonl" for k in range(CLIENTS))]
    summaries = [finished(client, report) for client, report in clients]
    assert all(summary["frames"] > 0 for summary in summaries)
    shares = joined(port_a), joined(port_b)
    assert sum(shares) == CLIENTS
    assert min(shares) >= 1

    first.handle.kill()
    first.handle.wait()
    survivor = tmp_path / "survivor.jsonl"
    assert finished(watch(port, survivor), survivor)["frames"] > 0
    assert joined(port_b) == shares[1] + 1


def sent_tiles(port: int) -> int:
    return metric(port, 'cags_sent_bytes_total{kind="tiles"}')


def test_sessions_of_a_killed_server_go_on_at_another_which_sends_nothing_they_hold(
    group: ProcessGroup, balance: Any, watch: Watch, tmp_path: Path
) -> None:
    bundle = tmp_path / "scene"
    encode = [sys.executable, "-m", "cags_encoder", "procedural:size=1500,frames=180", str(bundle)]
    encoded = subprocess.run(encode, capture_output=True, text=True, check=False)
    assert encoded.returncode == 0, encoded.stderr
    servers = [serve(group, str(bundle)) for _ in range(2)]
    port = balance(servers[0][1], servers[1][1])
    alone = tmp_path / "alone.jsonl"
    whole = finished(watch(port, alone), alone)["bytes_tiles"]

    report = tmp_path / "moved.jsonl"
    before = {number: joined(number) for _, number in servers}
    client = watch(port, report)
    deadline = time.monotonic() + DEADLINE_S
    while not (home := [server for server in servers if joined(server[1]) > before[server[1]]]):
        assert time.monotonic() < deadline, "the client does not join"
        time.sleep(0.05)
    time.sleep(2.5)  # two thirds of the play are to come
    (process, _), (_, other) = home[0], next(server for server in servers if server is not home[0])
    earlier = sent_tiles(other)
    process.handle.kill()
    summary = finished(client, report)
    assert summary["reconnects"] == 1
    assert summary["away_ms"] < 2_000
    assert summary["bytes_tiles"] <= 1.15 * whole  # what was on its way when the server died comes twice
    assert sent_tiles(other) - earlier < whole
