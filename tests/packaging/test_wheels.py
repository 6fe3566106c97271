"""What is published: wheels for which platforms, which extras there are, and one version throughout."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]


def project(folder: str = ".") -> dict[str, Any]:
    return dict(tomllib.loads((ROOT / folder / "pyproject.toml").read_text(encoding="utf-8")))


def test_cibuildwheel_takes_the_configuration_of_the_kernels() -> None:
    pytest.importorskip("cibuildwheel", reason="builds wheels; pip install '.[dev]'")
    command = [sys.executable, "-m", "cibuildwheel", "--platform", "linux", "--print-build-identifiers", "kernels"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert set(done.stdout.split()) == {
        f"cp311-{libc}_{machine}" for libc in ("manylinux", "musllinux") for machine in ("x86_64", "aarch64")
    }


def test_one_wheel_of_the_kernels_serves_every_python() -> None:
    kernels = project("kernels")
    assert kernels["tool"]["scikit-build"]["wheel"]["py-api"] == "py3"
    assert "cp311" in kernels["tool"]["cibuildwheel"]["build"][0]
    assert kernels["project"]["requires-python"] == ">=3.11"


def test_the_extras_that_the_documentation_names_exist_and_can_be_resolved_together() -> None:
    extras = project()["project"]["optional-dependencies"]
    assert {"view", "gpu", "research", "web", "scale", "dev"} <= set(extras)
    assert all(extras.values())  # none is empty
    pages = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
    named = {
        name
        for page in pages
        for group in re.findall(r"(?:cags-stream|\.)\[([a-z,]+)\]", page.read_text(encoding="utf-8"))
        for name in group.split(",")
    }
    assert named <= set(extras)


def test_every_constraint_is_one_exact_version() -> None:
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pins = [line.split("#")[0].strip() for line in lines]
    assert all(re.fullmatch(r"[A-Za-z0-9._-]+==[^=<>,; ]+", pin) for pin in pins if pin)


def test_both_distributions_have_one_version_and_the_changelog_tells_of_it() -> None:
    version = project()["project"]["version"]
    assert project("kernels")["project"]["version"] == version
    assert re.search(rf"^## {re.escape(version)}\b", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
