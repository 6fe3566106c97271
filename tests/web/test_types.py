"""The web client's types hold, sources and tests."""

from __future__ import annotations

import subprocess

import pytest

from support.node import WEB, node, why_not


def test_types() -> None:
    if reason := why_not():
        pytest.skip(reason)
    compiler = WEB / "node_modules" / "typescript" / "bin" / "tsc"
    done = subprocess.run([*node(), str(compiler), "--noEmit"], cwd=WEB, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-4000:]
