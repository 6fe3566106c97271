"""The Dockerfile's steps without an engine: what it copies is copied, what it runs is run, in a clean environment."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
OF_THE_SYSTEM = re.compile(r"^(apt-get|useradd)\b")
"""Steps that change the machine: the compiler and the user are those of whoever runs the test."""


def stages() -> list[list[tuple[str, str]]]:
    """(instruction, argument) of each stage, continued lines joined."""
    text = (ROOT / "Dockerfile").read_text(encoding="utf-8").replace("\\\n", " ")
    out: list[list[tuple[str, str]]] = []
    for line in text.splitlines():
        if not line.strip() or line.startswith("#"):
            continue
        instruction, _, argument = line.partition(" ")
        if instruction == "FROM":
            out.append([])
        out[-1].append((instruction, argument.strip()))
    return out


def ignored(folder: str, names: list[str]) -> set[str]:
    """What no clone holds: caches and builds."""
    return {name for name in names if name in ("__pycache__", "build", "_skbuild") or name.endswith((".so", ".pyc"))}


def copy(argument: str, source: Path) -> None:
    *sources, target = argument.split()
    for name in sources:
        into = source / target if len(sources) == 1 else source / target / name
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, into, ignore=ignored)
        else:
            into.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, into)


def commands(argument: str, opt: Path) -> str:
    """A RUN line with the image's places turned into ours, without the steps of the system."""
    steps = [step.strip() for step in argument.split("&&")]
    kept = [step for step in steps if not OF_THE_SYSTEM.match(step) and not step.startswith(("rm -rf /var", "chown"))]
    line = " && ".join(kept).replace("/opt/cags", str(opt)).replace("mkdir /data", "true")
    return re.sub(r"^python ", f"{sys.executable} ", line)


def run(line: list[str], folder: Path, environment: dict[str, str]) -> subprocess.CompletedProcess[str]:
    return subprocess.run(line, cwd=folder, env=environment, capture_output=True, text=True, timeout=1500, check=False)


def test_the_image_is_built_from_two_stages_and_ends_as_another_user() -> None:
    build, final = stages()
    assert build[0][1].endswith("AS build")
    assert ("COPY", "--from=build /opt/cags /opt/cags") in final
    assert [name for name, _ in final].index("USER") < [name for name, _ in final].index("CMD")


@pytest.mark.nightly
@pytest.mark.timeout(1800)
def test_the_steps_of_the_image_end_in_working_commands(tmp_path: Path) -> None:
    build, final = stages()
    source, opt, data = tmp_path / "src", tmp_path / "opt", tmp_path / "data"
    source.mkdir()
    data.mkdir()
    kept = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "VIRTUAL_ENV")}
    environment = {**kept, "PIP_DISABLE_PIP_VERSION_CHECK": "1"}
    for instruction, argument in build:
        if instruction == "COPY":
            copy(argument, source)
        elif instruction == "RUN" and (line := commands(argument, opt)):
            done = subprocess.run(
                ["bash", "-c", line],
                cwd=source,
                env=environment,
                capture_output=True,
                text=True,
                timeout=1500,
                check=False,
            )
            assert done.returncode == 0, f"{line}\n{done.stderr[-2000:]}"
    shutil.rmtree(source)  # the second stage has none of it
    environment["PATH"] = f"{opt / 'bin'}:{environment['PATH']}"
    command = next(argument for instruction, argument in final if instruction == "CMD")
    arguments = re.findall(r'"([^"]+)"', command)
    assert Path(shutil.which(arguments[0], path=environment["PATH"]) or "").parent == opt / "bin"
    for line in (arguments, ["cags-server", "--help"], ["cags-encode", "procedural:size=500,frames=2", "small.cags"]):
        done = subprocess.run(line, cwd=data, env=environment, capture_output=True, text=True, timeout=300, check=False)
        assert done.returncode == 0, f"{line}\n{done.stdout[-500:]}{done.stderr[-1500:]}"
    assert (data / "small.cags" / "manifest.json").exists()
