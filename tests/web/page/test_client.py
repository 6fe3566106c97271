"""The page with a client behind it: its messages are those of the client, its camera is its own where it steers."""

from __future__ import annotations

import json
from pathlib import Path

from support.node import run_tests

VECTORS = Path(__file__).parents[2] / "vectors" / "page" / "messages.json"


def test_messages_and_play(tmp_path: Path) -> None:
    run_tests("client", tmp_path, messages=json.loads(VECTORS.read_text()))
