"""Lines of benchmarks are plain JSON, whatever figures they hold."""

import json
import math

import numpy as np

from cags_bench.jsonl import check, dump, provenance, summary


def test_numpy_and_non_finite_figures_become_plain_json():
    line = json.loads(dump({"a": np.float32(1.5), "b": math.inf, "c": [np.int64(3), math.nan], "d": {"e": (1, 2)}}))
    assert line == {"a": 1.5, "b": None, "c": [3, None], "d": {"e": [1, 2]}}


def test_keys_are_sorted_so_that_runs_compare():
    assert dump({"b": 1, "a": 2}) == '{"a": 2, "b": 1}'


def test_the_summary_names_machine_commit_and_checks():
    line = summary("raster", [check("speed", "<= 1.0", 0.8, ok=True)], cases=3)
    assert line["summary"] is True
    assert line["checks"] == [{"name": "speed", "target": "<= 1.0", "value": 0.8, "ok": True}]
    assert set(provenance()) <= set(line)
