"""The web client's worker tells the page what goes wrong in it."""

from __future__ import annotations

from pathlib import Path

from support.node import run_tests


def test_the_worker(tmp_path: Path) -> None:
    run_tests("worker", tmp_path)
