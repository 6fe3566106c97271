"""A link that falls to a thirteenth: frames go on soon after what was in flight is through."""

from __future__ import annotations

from itertools import groupby
from pathlib import Path

import pytest

from cags_bench.bundles import cached_bundle
from cags_bench.sim.session import Scenario, simulate
from cags_client.settings import ClientSettings
from cags_encoder import EncodeSettings
from cags_server.settings import ServerSettings

FRAMES = 180
TRACE = "time_s,mbps\n0,2.34\n3,0.176\n"
MOST_MISSED = 30
"""Frames in a row: a second, most of which is what was in flight. With ends behind references it was two."""


@pytest.mark.slow
def test_after_a_fall_ends_of_frames_do_not_wait_for_references(tmp_path: Path) -> None:
    settings = EncodeSettings(frames=FRAMES, train_splats=4096, lod_order="paper")
    bundle = cached_bundle(f"procedural:size=10000,frames={FRAMES},seed=3", str(tmp_path / "bundles"), settings)
    trace = tmp_path / "fall.csv"
    trace.write_text(TRACE)
    server, client = ServerSettings(), ClientSettings(width=160, height=120)
    scenario = Scenario(bundle, str(trace), "synthetic:walking:seed=4", server=server, client=client, scored=False)
    frames = simulate(scenario).frames
    stalls = [len(list(run)) for missed, run in groupby(frames, lambda frame: bool(frame["missed"])) if missed]
    assert max(stalls, default=0) <= MOST_MISSED
