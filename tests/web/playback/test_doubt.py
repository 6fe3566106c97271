"""How far the page believes a picture where the splats are better: as Python's client."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from cags_common.correction.trust import doubted
from support.node import run_tests


def case(error: float, own: float) -> dict[str, Any]:
    return {"error": error, "own": None if math.isnan(own) else own, "taken": doubted(error, own)}


def test_errors_of_pictures(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    cases = [case(*(float(10 ** rng.uniform(-8, 0)) for _ in range(2))) for _ in range(60)]
    edges = [case(0.0, 0.0), case(1e-4, 0.0), case(1e-4, 1e-4), case(1e-4, math.nan), case(1.0, 1e-9)]
    run_tests("doubt", tmp_path, cases=[*cases, *edges])
