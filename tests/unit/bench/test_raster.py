"""``cags-bench raster`` end to end on a small scene, and its judgements on made-up figures."""

from __future__ import annotations

from dataclasses import replace

import pytest

import cags_kernels
from cags_bench.raster import backends
from cags_bench.raster.backends import measure_backends
from cags_bench.raster.cases import _growth_checks, _peer_checks, measure
from cags_bench.raster.hardware import measure_table
from cags_bench.raster.many_clients import Crowd, _side_by_side
from cags_bench.raster.settings import RasterSettings
from cags_bench.raster.upkeep import upkeep_checks
from cags_common.errors import ConfigError
from support.gpu import needs_adapter, software_passes

SMALL = RasterSettings(
    shared="nowhere",
    scenes="procedural:size=2000",
    sizes="48x32",
    threads="1",
    repetitions=1,
    warm_up=0,
    growth=False,
    peers=False,
)


@pytest.mark.skipif(not cags_kernels.native_available(), reason=cags_kernels.why_unavailable())
def test_a_small_run_has_every_line_and_a_summary_with_checks():
    lines = list(measure(SMALL))
    cases = [line.get("case") for line in lines]
    assert set(cases) == {"view", "upkeep", "limit", None}
    assert [line["level"] for line in lines if line.get("case") == "view"] == ["balanced", "fast", "exact"]
    summary = lines[-1]
    assert summary["summary"]
    assert {check["name"] for check in summary["checks"]} >= {
        "PSNR of balanced against the reference, worst view",
        "times faster than the fastest peer, worst view",
        "frame with harmonics of zeros / without any",
    }


def test_growth_is_judged_size_by_size():
    lines = [
        {"size": size, "splats": splats, "ms": ms}
        for size, splats, ms in [("a", 10, 1.0), ("a", 100, 9.0), ("b", 10, 1.0), ("b", 100, 11.0)]
    ]
    assert [check["ok"] for check in _growth_checks(lines)] == [True, False]
    assert _growth_checks([]) == []


@pytest.mark.parametrize(("ratios", "ok"), [([], False), ([60.0, 49.0], False), ([51.0, 300.0], True)])
def test_the_slowest_lead_over_a_peer_is_judged(ratios, ok):
    (check,) = _peer_checks(ratios)
    assert check["ok"] is ok
    assert "no peer is installed" in str(check["value"]) or ratios


def test_upkeep_is_judged_by_share_zeros_and_frame():
    line = {"updated": 4000, "splats": 100_000, "load_ms": 10.0, "update_ms": 1.0, "contribution_2_threads_ms": 40.0}
    line |= {"harmonics_of_zeros_ms": 10.3, "no_harmonics_ms": 10.0}
    assert [check["ok"] for check in upkeep_checks(line)] == [True, True, False]


@needs_adapter
def test_backends_are_held_to_the_definition_and_the_gpus_work_is_counted(monkeypatch):
    monkeypatch.setattr(backends, "WORK_SPLATS", 3000)  # else a scene of that many is made
    with software_passes():
        lines = list(measure_backends(replace(SMALL, sizes="64x48,96x64"), ["cpu", "gpu"]))
    *cases, last = lines
    assert [line["backend"] for line in cases if line["case"] == "backend"] == ["cpu", "gpu"] * 2
    assert all(line["psnr_db"] > 60 for line in cases if line["case"] == "backend")
    assert all(line["adapter"] for line in cases if line.get("backend") != "cpu")
    corrections = [line for line in cases if line["case"] == "correction"]
    assert [line["kind"] for line in corrections] == ["difference", "picture"] * 2
    for line in corrections:
        assert line["share_within_a_level"] >= 0.9999
        assert line["of_the_cpus"] >= 0.9999
        assert line["added_to"] > 0.5
    work = [line for line in cases if line["case"] == "work"]
    assert [line["bytes_total"] for line in work] == sorted((line["bytes_total"] for line in work), reverse=True)
    names = [check["name"] for check in last["checks"]]
    assert {"PSNR of gpu exact against the definition, worst view", "worst pixel of gpu exact"} <= set(names)
    assert sum("estimate" in name for name in names) == 3


@needs_adapter
def test_the_table_names_the_adapter_and_has_clients_and_growth():
    small = replace(SMALL, table=True, sizes="48x32", clients="1,3", servers="1,2", growing="500,900")
    with software_passes():
        *lines, last = measure_table(small)
    assert [line["stage"] for line in lines if line["case"] == "client"][:2] == ["drawn and shown", "whole frame"]
    shared = [(line["clients"], line["servers"], line["moving"]) for line in lines if line["case"] == "references"]
    assert shared == [(n, s, moving) for n, s in ((1, 1), (3, 1), (3, 2)) for moving in (False, True)]
    assert [line["splats"] for line in lines if line["case"] == "growth"] == [500, 900]
    assert all(line["adapter"] == last["adapter"] != "" for line in lines)
    assert last["checks"] == [], "targets are for 1600x1200 and 64 clients"


@needs_adapter
def test_a_server_that_fails_ends_the_others_with_its_reason():
    small = replace(SMALL, table=True, sizes="48x32", growing="500")
    crowds = [
        Crowd(small, 2, part, moving=False) for part in (range(1), range(5, 6))
    ]  # there is no fifth of two places
    with software_passes(), pytest.raises(IndexError):
        _side_by_side(crowds)


def test_the_table_without_hardware_is_refused_with_the_reason(monkeypatch):
    monkeypatch.setenv("CAGS_GPU_ADAPTER", "no such adapter")
    with pytest.raises(ConfigError, match=r"adapter|wgpu"):
        list(measure_table(SMALL))
