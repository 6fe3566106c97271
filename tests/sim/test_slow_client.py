"""A client that cannot draw every frame gets references of the frames that it does draw, and of few others."""

from dataclasses import replace

import pytest

from cags_bench.bundles import cached_bundle
from cags_bench.jsonl import dump
from cags_bench.sim.session import Scenario, simulate
from cags_client.playback.quality import Quality
from cags_client.settings import ClientSettings
from cags_encoder import EncodeSettings
from cags_server.session.connection import Connection

FRAMES = 70
SETTLED = 40
"""Frames after which the client has told what it can do."""

INVISIBLE_DB = 55.0
"""PSNR above which nobody sees a difference: from there sessions differ by 3 dB either way."""


@pytest.fixture(scope="module")
def scenario(tmp_path_factory) -> Scenario:
    cache = str(tmp_path_factory.mktemp("bundles"))
    bundle = cached_bundle(f"procedural:size=2000,frames={FRAMES}", cache, EncodeSettings(frames=FRAMES))
    # No other way to save time than to draw fewer, and none to gather detail before the first frame.
    client = ClientSettings(width=80, height=60, resolution="full", startup_ms=0)
    return Scenario(bundle, "generated:steady-0.8", "synthetic:walking", client=client)


@pytest.fixture
def renders(monkeypatch) -> list[int]:
    """Frames that the server rendered references of."""
    frames: list[int] = []
    next_job = Connection.next_job

    def counted(self, now_us):
        job = next_job(self, now_us)
        if job is not None:
            frames.append(job.plan.frame)
        return job

    monkeypatch.setattr(Connection, "next_job", counted)
    return frames


def settled(frames):
    return [frame for frame in frames if frame >= SETTLED]


def test_a_slow_client_gets_references_of_what_it_draws(scenario, renders, monkeypatch):
    slow = replace(scenario, draw_us=52_000)
    shown = simulate(slow).frames
    late = [f for f in shown if f["frame"] >= SETTLED]
    fewer = settled(renders)
    assert sum(f["reference_frame"] == f["frame"] for f in late) >= 0.9 * len(late)
    assert not any(f["missed"] for f in late)
    assert len(fewer) <= 1.2 * len(late), "hardly a render of what nobody sees"
    renders.clear()
    monkeypatch.setattr(Quality, "observe", lambda self, *args, **named: None)
    silent = [f for f in simulate(slow).frames if f["frame"] >= SETTLED]
    assert len(late) >= len(silent) - 2, "it draws as many as one that says nothing of it"
    assert len(settled(renders)) >= 1.3 * len(fewer)


def test_what_a_slow_client_is_spared_costs_nothing_that_is_seen(scenario, monkeypatch):
    slow = replace(scenario, draw_us=52_000)
    late = [f for f in simulate(slow).frames if f["frame"] >= SETTLED]
    monkeypatch.setattr(Quality, "observe", lambda self, *args, **named: None)
    silent = [f for f in simulate(slow).frames if f["frame"] >= SETTLED]
    mean = [sum(f["psnr_restored_db"] for f in frames) / len(frames) for frames in (late, silent)]
    assert mean[0] >= min(mean[1], INVISIBLE_DB)


def test_a_client_that_draws_in_time_gets_what_one_gets_that_takes_none(scenario):
    quick, none = simulate(replace(scenario, draw_us=20_000)), simulate(scenario)
    told = ("frame", "reference_frame", "bytes_tiles", "bytes_reference", "psnr_restored_db")
    assert dump({"f": [{k: f[k] for k in told} for f in quick.frames]}) == dump(
        {"f": [{k: f[k] for k in told} for f in none.frames]}
    )
