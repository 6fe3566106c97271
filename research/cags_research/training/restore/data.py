"""Crops of every scene, made once and found again."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from cags_common.bundle.reader import MANIFEST_NAME
from cags_encoder.cache import content_key
from cags_encoder.settings import EncodeSettings
from cags_research.training.pairs.crops import Crops, make_crops
from cags_research.training.pairs.ladder import Ladder, is_bundle
from cags_research.training.pairs.maker import PairMaker
from cags_research.training.pairs.settings import PairSettings
from cags_research.training.pairs.views import focus_of_manifest, open_walks

PAIRS_VERSION = 11
"""Raised whenever the same scene and settings give other crops."""

Tell = Callable[[str, int, int], None]
"""Called with the stage's name, steps done and steps in all."""


def crops_of_scenes(
    scenes: Sequence[str], walks: Sequence[str], settings: PairSettings, folder: Path, tell: Tell
) -> Crops:
    """Crops of all ``scenes``, seen along ``walks``; those that ``folder`` holds already are not made again.

    Raises what opening, encoding and reading raise.
    """
    parts = []
    for spec in scenes:
        path = folder / f"{_key(spec, walks, settings)}.npz"
        if not path.exists():
            _made(spec, walks, settings, tell).save(path)
        parts.append(Crops.load(path))
        tell(f"pairs of {spec}", 1, 1)
    return Crops.concatenate(parts)


def _made(spec: str, walks: Sequence[str], settings: PairSettings, tell: Tell) -> Crops:
    rng = np.random.default_rng((settings.seed, int(_key(spec, (), settings), 16)))
    names = settings.quantiser_list
    share = replace(settings, views=-(-settings.views // len(names)))
    parts: list[Crops] = []
    names = names[:1] if is_bundle(spec) else names  # a bundle has been quantised
    for number, name in enumerate(names):
        ladder = Ladder.of_scene(spec, EncodeSettings(seed=settings.seed, quantiser=name))
        placed = open_walks(tuple(walks), focus_of_manifest(ladder.manifest), settings.seed)
        made = share.views * number

        def told(done: int, total: int, made: int = made) -> None:
            tell(f"pairs of {spec}", made + done, total * len(names))

        parts.append(make_crops(PairMaker(ladder, placed, settings), share, rng, told))
    return Crops.concatenate(parts)


def _key(spec: str, walks: Sequence[str], settings: PairSettings) -> str:
    if is_bundle(spec):
        scene = hashlib.sha256((Path(spec) / MANIFEST_NAME).read_bytes()).hexdigest()
    else:
        scene = content_key(spec, EncodeSettings(frames=1, seed=settings.seed))
    facts = repr((PAIRS_VERSION, scene, tuple(Path(walk).name for walk in walks), sorted(asdict(settings).items())))
    return hashlib.sha256(facts.encode()).hexdigest()[:16]
