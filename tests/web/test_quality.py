"""What the page does with its device's time: what Python's client would, picture by picture."""

from __future__ import annotations

import random
from pathlib import Path
from typing import Any

from cags_client.playback.quality import SCALES, Quality, newest_due, next_due
from cags_client.settings import AUTO, INTERPOLATIONS
from support.node import run_tests

LADDERS = [[1.0], [0.35, 0.5, 0.7, 1.0], list(SCALES[AUTO])]
RATES = [24.0, 30.0, 60.0, 90.0, 120.0]


def _play(seed: int) -> dict[str, Any]:
    """A machine whose speed, load and viewer's wishes change now and then."""
    rng = random.Random(seed)
    ladder, display, skips = rng.choice(LADDERS), 1e6 / rng.choice(RATES), rng.random() < 0.8
    began, quality = (ladder, display), Quality(ladder, display, skips=skips)
    now, steps = rng.randrange(1_000_000), []
    period, fixed, pixels, load = 1e6 / 30, rng.uniform(100, 30_000), rng.uniform(100, 60_000), 1.0
    for number in range(400):
        wish = [ladder, rng.choice(INTERPOLATIONS)] if number == 0 else None
        if rng.random() < 0.01:
            ladder = rng.choice(LADDERS)
            wish = [ladder, rng.choice(INTERPOLATIONS)]
        if rng.random() < 0.02:
            load = rng.choice([1.0, 1.0, 0.3, 3.0])
        period = 1e6 / rng.choice(RATES[:2]) if rng.random() < 0.01 else period
        display = 1e6 / rng.choice(RATES) if rng.random() < 0.01 else display
        restart, media = rng.random() < 0.01, quality.step_us is None or rng.random() < 0.5
        if wish is not None:
            quality.wish(*wish)
        quality.period_us, quality.display_us = period, display
        if restart:
            quality.restart()
        area = load * pixels * quality.scale**2 * rng.uniform(0.8, 1.2)
        took = area + load * fixed * rng.uniform(0.8, 1.2) + (rng.random() < 0.02) * 300_000
        now += max(round(took), rng.randrange(round(period)))
        quality.observe(now, took, area, media=media)
        due = now + rng.uniform(0, 2 * period)
        steps.append(
            {"wish": wish, "period": period, "display": display, "restart": restart, "now": now, "took": took}
            | {"pixels": area, "media": media, "scale": quality.scale, "permille": quality.permille}
            | {"step": quality.step_us, "fits": [due, quality.fits(now, due)]}
        )
    return {"scales": began[0], "display": began[1], "skips": skips, "steps": steps}


def _ticks(rng: random.Random) -> dict[str, int]:
    tick, permille = rng.randrange(1000), rng.choice([1000, 999, 731, 500, 250])
    end = tick + rng.randrange(1, 40)
    first = next_due(tick, end, permille)
    now = first + rng.randrange(30)
    newest = newest_due(first, end, permille, lambda each: each <= now)
    return {"tick": tick, "end": end, "permille": permille, "now": now, "next": first, "newest": newest}


def test_the_page_chooses_what_python_does(tmp_path: Path) -> None:
    plays = [_play(seed) for seed in range(40)]
    chosen = [(step["scale"], step["permille"], step["step"]) for play in plays for step in play["steps"]]
    assert len({scale for scale, _, _ in chosen}) == 4
    assert len({permille for _, permille, _ in chosen}) > 20
    assert len({step for _, _, step in chosen}) > 3
    run_tests("quality", tmp_path, plays=plays, ticks=[_ticks(random.Random(seed)) for seed in range(300)])
