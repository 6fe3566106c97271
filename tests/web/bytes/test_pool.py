"""The web client's memory for patches is used again."""

from __future__ import annotations

from pathlib import Path

from support.node import run_tests


def test_the_pool(tmp_path: Path) -> None:
    run_tests("pool", tmp_path)
