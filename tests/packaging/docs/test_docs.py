"""The documentation builds, its links hold, and what it tells people to type works."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from importlib.metadata import distribution
from pathlib import Path

import pytest

from cags_encoder.formats import write_splats
from cags_encoder.scenes import open_scene
from cags_protocol.wire.messages import RefusalCode
from support.capture import three_balls

ROOT = Path(__file__).parents[3]
DOCS = ROOT / "docs"
PAGES = sorted(path.relative_to(DOCS).as_posix() for path in DOCS.rglob("*.md"))
FENCE = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def blocks(page: str, language: str) -> list[str]:
    """Fenced blocks of a page: ``sh`` and ``python`` are meant to be run, ``console`` and ``text`` to be read."""
    text = (DOCS / page).read_text(encoding="utf-8")
    return [body for kind, body in FENCE.findall(text) if kind == language]


def test_the_site_builds_without_a_warning(tmp_path: Path) -> None:
    pytest.importorskip("mkdocs", reason="mkdocs builds the site; pip install '.[docs]'")
    pytest.importorskip("material", reason="the site's theme; pip install '.[docs]'")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "-q", "-d", str(tmp_path / "site")]
    environment = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    result = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stdout + result.stderr
    home = (tmp_path / "site/index.html").read_text(encoding="utf-8")
    assert "fonts.googleapis.com" not in home


@pytest.mark.parametrize("page", [page for page in PAGES if blocks(page, "python")])
def test_python_blocks_run(page: str, tmp_path: Path) -> None:
    for body in blocks(page, "python"):
        command = [sys.executable, "-W", "error", "-c", body]
        result = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
        assert result.returncode == 0, f"{body}\n{result.stderr}"


@pytest.mark.slow
@pytest.mark.parametrize("page", [page for page in PAGES if blocks(page, "sh")])
def test_shell_blocks_run_in_order(page: str, tmp_path: Path) -> None:
    bin_folder = str(Path(sys.executable).parent)
    script = "set -eum\ntrap 'kill $(jobs -p) 2> /dev/null || true' EXIT\n" + "\n".join(blocks(page, "sh"))
    environment = {**os.environ, "PATH": f"{bin_folder}{os.pathsep}{os.environ['PATH']}"}
    result = subprocess.run(
        ["bash", "-c", script], cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=240, check=False
    )
    logs = "".join(f"\n{log.name}: {log.read_text()}" for log in tmp_path.glob("*.log"))
    assert result.returncode == 0, result.stdout + result.stderr + logs


def test_scene_options_that_pages_tell_of_are_taken(tmp_path: Path) -> None:
    capture = tmp_path / "a.ply"
    write_splats(capture, three_balls(5, 5))
    told = {
        option
        for page in PAGES
        for option in re.findall(r"`[\w./]*:([a-z]+=[\w.+/-]+)`", (DOCS / page).read_text(encoding="utf-8"))
    }
    assert {"up=z", "repair=drop"} <= told
    for option in told - {"size=60000"}:
        assert len(open_scene(f"{capture}:{option}")) > 0, option


def test_the_wire_page_lists_every_reason_of_a_refusal() -> None:
    row = next(line for line in (DOCS / "wire.md").read_text(encoding="utf-8").splitlines() if "| `refusal` |" in line)
    listed = row.partition("codes: ")[2].partition(";")[0]
    assert listed.split(", ") == [code.value for code in RefusalCode]


def test_console_commands_are_known() -> None:
    typed = {
        line.removeprefix("$ ").split()[0]
        for page in PAGES
        for body in blocks(page, "console")
        for line in body.splitlines()
        if line.startswith("$ cags-")
    }
    assert typed <= {e.name for e in distribution("cags-stream").entry_points}
