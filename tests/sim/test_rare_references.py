"""A slow link, moving parts, a reference for every third frame: many frames have one of another frame."""

from __future__ import annotations

from pathlib import Path

import pytest

from cags_bench.bundles import cached_bundle
from cags_bench.sim.session import Scenario, simulate
from cags_client.settings import ClientSettings
from cags_encoder import EncodeSettings
from cags_server.settings import ServerSettings

FRAMES = 30


@pytest.fixture(scope="module")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    settings = EncodeSettings(frames=FRAMES, train_splats=4096, lod_order="paper")
    return cached_bundle("procedural:size=12000,frames=30,seed=3", str(tmp_path_factory.mktemp("bundles")), settings)


@pytest.mark.parametrize("startup_ms", [1000, 1500, 3000])
def test_late_and_rare_references_make_no_picture_worse(bundle: Path, startup_ms: int) -> None:
    client = ClientSettings(width=160, height=120, startup_ms=startup_ms)
    server = ServerSettings(reference_every=3)
    scenario = Scenario(
        bundle, "generated:steady-2", "synthetic:walking", server=server, client=client, delay_us=60_000
    )
    restored = [frame for frame in simulate(scenario).frames if "correction" in frame["effects"]]
    assert restored, "no reference came in time to be of use"
    gains = [frame["psnr_restored_db"] - frame["psnr_distorted_db"] for frame in restored]
    worst = restored[gains.index(min(gains))]
    assert min(gains) >= -0.5, worst
    assert sum(gains) / len(gains) > 0
