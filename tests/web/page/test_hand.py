"""A hand on the page's picture, keys and sticks move the camera the way they go."""

from __future__ import annotations

from pathlib import Path

from support.node import run_tests


def test_the_hand(tmp_path: Path) -> None:
    run_tests("hand", tmp_path)
