"""How much of a reference the page uses from how far away: as Python's client."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from cags_common.correction.reach import HOLDS, apart, valid_share
from cags_common.geometry import Pose, Vec3
from support.node import run_tests


def case(seed: int) -> dict[str, Any]:
    rng = np.random.default_rng(seed)

    def vec(size: float) -> Vec3:
        x, y, z = rng.normal(0, size, 3)
        return float(x), float(y), float(z)

    centre, radius = vec(1.0), float(rng.uniform(0.1, 3))
    here = Pose.looking_at(vec(2.0), centre)
    there = Pose.looking_at(tuple(np.add(here.position, vec(0.3))), tuple(np.add(centre, vec(0.3))))
    reach = float(rng.uniform(0, HOLDS))
    distance = apart(here, there, centre, radius)
    return {
        "poses": [{"position": pose.position, "rotation": pose.rotation} for pose in (here, there)],
        "centre": centre,
        "radius": radius,
        "reach": reach,
        "apart": distance,
        "share": valid_share(distance, reach),
    }


def test_shares_of_references(tmp_path: Path) -> None:
    run_tests("reach", tmp_path, cases=[case(seed) for seed in range(60)])
