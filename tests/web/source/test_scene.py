"""What the page takes on of a scene."""

from __future__ import annotations

from pathlib import Path

from support.node import run_tests


def test_memory(tmp_path: Path) -> None:
    run_tests("scene", tmp_path)
