"""The page and the server say alike which media frame is displayed when."""

from __future__ import annotations

import json
from pathlib import Path

from support.node import run_tests

VECTORS = Path(__file__).parents[1] / "vectors" / "timeline" / "v1.json"


def test_recorded_timelines(tmp_path: Path) -> None:
    run_tests("timeline", tmp_path, timeline=json.loads(VECTORS.read_text()))
