"""A second without any delivery after two seconds of a fast link: what moves goes on moving."""

from __future__ import annotations

from pathlib import Path

import pytest

from cags_bench.bundles import cached_bundle
from cags_bench.sim.session import Scenario, simulate
from cags_client.settings import ClientSettings
from cags_encoder import EncodeSettings
from cags_server.settings import ServerSettings

FRAMES = 105
TRACE = "time_s,mbps\n0,20\n2.3,0\n3.3,20\n"


@pytest.fixture(scope="module")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    settings = EncodeSettings(frames=FRAMES, train_splats=4096, lod_order="paper")
    return cached_bundle(f"procedural:size=3000,frames={FRAMES},seed=3", str(tmp_path_factory.mktemp("b")), settings)


def missed(bundle: Path, trace: Path, reserve_s: float) -> int:
    server, client = ServerSettings(reserve_s=reserve_s), ClientSettings(width=160, height=120)
    scenario = Scenario(bundle, str(trace), "synthetic:walking:seed=4", server=server, client=client, scored=False)
    return sum(frame["missed"] for frame in simulate(scenario).frames)


def test_frames_sent_ahead_bridge_an_outage(bundle: Path, tmp_path: Path) -> None:
    trace = tmp_path / "outage.csv"
    trace.write_text(TRACE)
    assert missed(bundle, trace, 0.0) > 15
    assert missed(bundle, trace, 2.0) == 0
