"""A headset's eyes as cameras, and where a visitor stands: by random frusta, poses and scenes."""

from __future__ import annotations

from pathlib import Path

from support.node import run_tests


def test_eyes_and_stance(tmp_path: Path) -> None:
    run_tests("xr", tmp_path)
