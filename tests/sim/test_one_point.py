"""Scenes without extent: one splat, and several at one point."""

from pathlib import Path

import numpy as np
import pytest

from cags_bench.sim.session import Scenario, simulate
from cags_client.settings import ClientSettings
from cags_encoder import EncodeSettings, encode
from support.codec_scenes import cloud, with_changes


@pytest.mark.parametrize("count", [1, 5])
def test_it_plays(count: int, tmp_path: Path) -> None:
    splats = with_changes(cloud(count), means=np.zeros((count, 3)), logit_opacities=np.full(count, 3))
    encode([splats] * 12, EncodeSettings(), str(tmp_path / "a.cags"))
    client = ClientSettings(width=160, height=120)
    session = simulate(Scenario(tmp_path / "a.cags", "generated:steady-30", "synthetic:walking", client=client))
    assert session.summary["frames_missed"] == 0
    assert session.summary["psnr_restored_db"] > 30
    assert min(frame["psnr_covered_restored_db"] or 0 for frame in session.frames) < 100, "something is in the picture"
