"""The compose testbed, without an engine: two independent checkers, and that everything it names is there."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import Any

import pytest

yaml = pytest.importorskip("yaml", reason="PyYAML reads the compose file; pip install '.[dev]'")

ROOT = Path(__file__).parents[3]
PROFILES = ("viewer", "metrics", "scale")
MODULES = {
    "cags-encode": "cags_encoder",
    "cags-server": "cags_server",
    "cags-shaper": "cags_shaper",
    "cags-client": "cags_client",
}


@pytest.fixture(scope="module")
def compose() -> dict[str, Any]:
    return dict(yaml.safe_load((ROOT / "docker-compose.yml").read_text(encoding="utf-8")))


def test_the_specification_s_own_model_takes_it(compose: dict[str, Any]) -> None:
    spec = pytest.importorskip("compose_spec", reason="pip install compose-spec")
    parsed = spec.PyCompose.from_yaml(yaml.safe_dump(compose))  # PyYAML has applied the merge keys
    parsed.validate()
    assert {"encode", "server", "shaper", "client"} <= set(parsed.service_names())


def test_docker_compose_takes_every_profile(compose: dict[str, Any]) -> None:
    package = pytest.importorskip("compose", reason="Docker Compose as a Python package; pip install '.[dev]'")
    tool = Path(package.__file__).parent / "docker-compose"  # the package's own command swallows exit codes
    profiles = [flag for profile in PROFILES for flag in ("--profile", profile)]
    command = [str(tool), *profiles, "config", "--format", "json"]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    assert result.stderr == ""  # it warns of variables without a value and of what is out of date
    assert set(json.loads(result.stdout)["services"]) == set(compose["services"])


@cache
def flags_of(module: str) -> frozenset[str]:
    result = subprocess.run([sys.executable, "-m", module, "--help"], capture_output=True, text=True, check=True)
    return frozenset(re.findall(r"--[a-z][a-z-]+", result.stdout))


def test_every_flag_that_a_service_uses_exists(compose: dict[str, Any]) -> None:
    for name, service in compose["services"].items():
        command = service.get("command", [])
        if not command or command[0] not in MODULES:
            continue
        used = {word.partition("=")[0] for word in command if word.startswith("--")}
        assert used <= flags_of(MODULES[command[0]]), name


def test_what_is_mounted_is_there(compose: dict[str, Any]) -> None:
    for name, service in compose["services"].items():
        for volume in service.get("volumes", []):
            source = volume.split(":")[0]
            known = (ROOT / source).exists() if source.startswith(".") else source in compose["volumes"]
            assert known, f"{name} mounts {source}"


def test_nothing_starts_before_what_it_needs_answers(compose: dict[str, Any]) -> None:
    for name, service in compose["services"].items():
        for needed, how in service.get("depends_on", {}).items():
            other = compose["services"][needed]
            if how["condition"] == "service_healthy":
                assert other["healthcheck"]["test"][0] == "CMD", f"{name} waits for {needed}"
            else:  # work that ends, or workers that a scheduler waits for
                assert needed in {"encode", "encode-to-store", "encode-worker"}, f"{name} does not wait for {needed}"


def test_the_health_of_the_shaper_is_not_asked_over_its_link(compose: dict[str, Any]) -> None:
    """The trace's time begins with the first connection: a health check there would begin it long before the client."""
    shaper = compose["services"]["shaper"]
    (control,) = [word.rpartition(":")[2] for word in shaper["command"] if word.startswith("--control=")]
    (listen,) = [word.rpartition(":")[2] for word in shaper["command"] if word.startswith("--listen=")]
    asked = shaper["healthcheck"]["test"][-1]
    assert control in asked
    assert listen not in asked


def test_our_containers_are_confined_and_ports_stay_on_loopback(compose: dict[str, Any]) -> None:
    for name, service in compose["services"].items():
        if service.get("image") == "cags-stream":
            assert service["read_only"], name
        assert service["cap_drop"] == ["ALL"], name
        assert service["security_opt"] == ["no-new-privileges:true"], name
        assert service["pids_limit"], name
        assert service["mem_limit"], name
        assert all(port.startswith("127.0.0.1:") for port in service.get("ports", [])), name


def test_the_image_copies_every_package_and_runs_as_nobody_special() -> None:
    dockerfile = (ROOT / "Dockerfile").read_text(encoding="utf-8")
    copied = {
        source
        for line in re.findall(r"^COPY (?!--from)(.+)$", dockerfile, re.MULTILINE)
        for source in line.split()[:-1]
    }
    assert all((ROOT / source).exists() for source in copied)
    kept = {line[1:] for line in (ROOT / ".dockerignore").read_text().splitlines() if line.startswith("!")}
    assert copied <= kept
    import tomllib

    hatch = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["hatch"]["build"]
    assert {package.split("/")[0] for package in hatch["targets"]["wheel"]["packages"]} <= copied
    assert re.search(r"^USER cags$", dockerfile, re.MULTILINE)


def test_nginx_takes_its_configuration(tmp_path: Path) -> None:
    nginx = shutil.which("nginx") or shutil.which("nginx", path="/usr/sbin")
    if nginx is None:
        pytest.skip("no nginx here; apt-get install nginx-light")
    text = (ROOT / "deploy/nginx/nginx.conf").read_text(encoding="utf-8")
    local = tmp_path / "nginx.conf"
    local.write_text(re.sub(r"server-[ab]:8765", "127.0.0.1:8765", text).replace("/tmp/", f"{tmp_path}/"))
    result = subprocess.run([nginx, "-t", "-c", str(local)], capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr


def test_prometheus_takes_its_configuration() -> None:
    tool = shutil.which("promtool")
    if tool is None:
        pytest.skip("no promtool here; apt-get install prometheus")
    path = ROOT / "deploy/prometheus/prometheus.yml"
    result = subprocess.run([tool, "check", "config", str(path)], capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr


def test_the_dashboard_asks_for_what_servers_tell_and_nothing_else() -> None:
    from cags_server.http.metrics import exposition
    from cags_server.records import Totals

    told = set(re.findall(r"^# TYPE (\w+)", exposition(Totals(), []), re.MULTILINE))
    told |= {f"{name}_{part}" for name in told for part in ("sum", "count")}
    dashboard = json.loads((ROOT / "deploy/grafana/dashboards/cags-stream.json").read_text(encoding="utf-8"))
    asked = {
        name
        for panel in dashboard["panels"]
        for target in panel["targets"]
        for name in re.findall(r"\b(?:cags|process)_\w+", target["expr"])
    }
    assert asked <= told
    shown = {name.removesuffix("_sum").removesuffix("_count") for name in asked}
    assert {name for name in told if name.startswith("cags_") and not name.endswith(("_sum", "_count"))} <= shown
