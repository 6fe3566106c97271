"""How long the page holds its first frame: as long as Python's client does."""

from __future__ import annotations

import random
from pathlib import Path
from typing import Any

from cags_client.playback.startup import Startup
from cags_client.settings import ClientSettings
from support.node import run_tests


def _play(seed: int) -> dict[str, Any]:
    rng = random.Random(seed)
    most, now = rng.choice([0, 300_000, 700_000]), rng.randrange(1_000_000)
    begun, startup, steps = now, Startup(most, now), []
    for _ in range(60):
        now += rng.choice([0, 5_000, 60_000, 260_000])
        op = rng.choices(["came", "preview", "whole"], [5, 4, 1])[0]
        tile, equipped = rng.random() < 0.5, rng.random() < 0.7
        said = startup.came(now, tile=tile, equipped=equipped) if op == "came" else getattr(startup, op)(now)
        steps.append({"op": op, "now": now, "tile": tile, "equipped": equipped, "said": said, "ends": startup.ends_us})
    return {"most": most, "begun": begun, "steps": steps}


def test_the_first_frame_is_held_by_the_same_rule(tmp_path: Path) -> None:
    plays = [_play(seed) for seed in range(40)]
    assert any(step["ends"] is None for play in plays for step in play["steps"])
    run_tests("startup", tmp_path, holds={"longest": ClientSettings().startup_ms * 1000, "plays": plays})
