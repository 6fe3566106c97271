"""The web client's player without a display: what is shown when, and what is waited for."""

from __future__ import annotations

from pathlib import Path

from support.node import run_tests


def test_the_player(tmp_path: Path) -> None:
    run_tests("player", tmp_path)


def test_references(tmp_path: Path) -> None:
    run_tests("references", tmp_path)
