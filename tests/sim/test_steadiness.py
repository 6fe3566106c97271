"""Levels of quality on a link that comes and goes: what has been refined stays so, and motion seldom coarsens."""

from __future__ import annotations

from collections import defaultdict
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cags_bench.bundles import cached_bundle
from cags_bench.sim.session import Scenario, simulate
from cags_client.frame.pipeline import ClientPipeline
from cags_client.frame.presented import PresentedFrame
from cags_client.settings import ClientSettings
from cags_encoder import EncodeSettings

FRAMES = 45

Levels = dict[tuple[int, int], list[int]]
"""Displayed level of every tile of looks, or of its motion, in each frame that shows it."""


def room(size: int, folder: Path) -> Path:
    settings = EncodeSettings(frames=FRAMES, train_splats=4096, lod_order="paper")
    return cached_bundle(f"procedural:size={size},frames={FRAMES},seed=3", str(folder), settings)


def played(bundle: Path, trace: str, monkeypatch: pytest.MonkeyPatch) -> tuple[Levels, Levels]:
    """Levels of looks and of motion, picture by picture."""
    looks: Levels = defaultdict(list)
    motion: Levels = defaultdict(list)
    draw = ClientPipeline.present

    def present(pipe: ClientPipeline, *inputs: Any, **options: Any) -> PresentedFrame:
        shown, store = draw(pipe, *inputs, **options), pipe.on_display
        assert store is not None
        for tile, level in store.shown.visible_lods(np.ones(store.capacity, np.float32)).items():
            looks[tile].append(level)
            start = store._buffer.moves(tile)
            chunk = None if start is None else store._tiles.chunk(tile, start)
            if chunk is not None:
                motion[tile].append(chunk.shown_lod)
        return shown

    monkeypatch.setattr(ClientPipeline, "present", present)
    client = ClientSettings(width=160, height=120)
    simulate(Scenario(bundle, trace, "synthetic:walking:seed=4", client=client, scored=False))
    return looks, motion


def changes(levels: list[int]) -> list[int]:
    return [after - before for before, after in pairwise(levels) if after != before]


@pytest.mark.parametrize(("trace", "size"), [("generated:steady-0.5", 6_000), ("generated:sawtooth", 10_000)])
def test_no_tile_goes_back_and_forth_between_two_levels(
    tmp_path: Path, trace: str, size: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    looks, motion = played(room(size, tmp_path), trace, monkeypatch)
    refined = [change for levels in looks.values() for change in changes(levels)]
    assert refined, "nothing was refined: the link is too fast or too slow for this test"
    assert min(refined) > 0
    turns = sum(a * b < 0 for levels in motion.values() for a, b in pairwise(changes(levels)))
    assert motion
    assert turns <= len(motion), "more than one turn a tile in a second and a half"
