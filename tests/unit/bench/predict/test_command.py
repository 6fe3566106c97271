"""``cags-bench predict``, played small: every predictor and policy is judged."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from cags_common.poses import Focus, synthetic_walk, write_poses
from support.bench_lines import lines_of


def test_predict_judges_every_predictor_and_policy(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    around = Focus((0.0, 0.0, 0.0), 2.0, (0.0, -1.0, 0.0))
    for seed, person in enumerate(("01", "02", "09", "10")):
        walk = synthetic_walk("walking", around, seed=seed, duration_s=4.0)
        write_poses(walk, tmp_path / f"room_user{person}.csv")
    choices = ["--horizons-ms", "100,200", "--every-ms", "400", "--people", "all", "--seconds", "2"]
    lines = lines_of(capsys, "predict", "--poses", str(tmp_path), *choices)
    found = json.dumps(lines)
    assert all(name in found for name in ("hold", "linear", "autoregressive", "kalman", "fixed", "quantile", "lstm"))
    errors = [value for line in lines for key, value in line.items() if key.startswith("angular")]
    assert errors and all(0 <= float(error) < 30 for error in errors)  # type: ignore[arg-type]
