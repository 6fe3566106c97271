"""The page's side of its worker: answers, failures, and memory that goes back."""

from __future__ import annotations

from pathlib import Path

from support.node import run_tests


def test_the_page_and_its_worker(tmp_path: Path) -> None:
    run_tests("remote", tmp_path)
