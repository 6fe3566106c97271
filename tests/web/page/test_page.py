"""What anybody may write into the page's address, send to it, or do to its window."""

from __future__ import annotations

from pathlib import Path

from support.node import run_tests


def test_the_page(tmp_path: Path) -> None:
    run_tests("page", tmp_path)
