"""The examples of the page on extending are entered as it says, and a scene is played with all three."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from cags_bench.bundles import cached_bundle
from cags_bench.sim.session import Scenario, simulate
from cags_client.frame.restore import RESTORERS
from cags_client.settings import ClientSettings
from cags_encoder import EncodeSettings
from cags_server.predict import PREDICTORS
from cags_server.ratecontrol import RATE_POLICIES
from cags_server.settings import ServerSettings

PAGE = Path(__file__).parents[3] / "docs" / "how-to" / "extend.md"
REGISTRIES: tuple[dict[str, Any], ...] = (PREDICTORS, RATE_POLICIES, RESTORERS)


@pytest.fixture
def entered() -> Iterator[list[str]]:
    """Names that the page's classes have in the three registries, from which they are gone after the test."""
    before = [dict(registry) for registry in REGISTRIES]
    try:
        for block in re.findall(r"^```python\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.M | re.S):
            exec(block, {})
        yield [name for registry, old in zip(REGISTRIES, before, strict=True) for name in registry if name not in old]
    finally:
        for registry, old in zip(REGISTRIES, before, strict=True):
            registry.clear()
            registry.update(old)


def test_a_scene_plays_with_the_page_s_predictor_policy_and_restorer(entered: list[str], tmp_path: Path) -> None:
    predictor, abr, restore = entered
    settings = EncodeSettings(frames=8, train_splats=1000, lod_order="paper")
    bundle = cached_bundle("procedural:size=800,frames=8", str(tmp_path), settings)
    server = ServerSettings(predictor=predictor, abr=abr, reference_width=64, reference_height=48)
    client = ClientSettings(width=96, height=72, restore=restore, effects="always")
    summary = simulate(Scenario(bundle, "generated:steady-30", "synthetic:walking", server, client)).summary
    assert summary["frames"] == 8
    assert summary["restorers"] == {restore: 8}
    assert summary["bytes_tiles"] > 0
    assert summary["aligned_share"] > 0.3
