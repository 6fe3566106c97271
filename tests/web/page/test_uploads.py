"""What the gallery does with files that are dropped on it, and says of those that are not taken."""

from __future__ import annotations

from pathlib import Path

from support.node import run_tests


def test_uploads(tmp_path: Path) -> None:
    run_tests("uploads", tmp_path)
