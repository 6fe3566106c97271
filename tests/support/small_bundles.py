"""Bundles of a few splats, quickly encoded."""

from __future__ import annotations

from pathlib import Path

from cags_common.splats import Splats
from cags_encoder.pipeline import encode
from cags_encoder.settings import EncodeSettings
from support.capture import three_balls


def small_bundle(out: Path, *, frames: int = 1, seed: int = 5, view: str = "") -> Path:
    """A bundle of three balls at ``out``; ``view`` is the path of an author's view."""
    held: list[Splats] = [three_balls(40, seed)] * frames
    encode(held, EncodeSettings(lod_order="paper", train_splats=256, view=view), str(out))
    return out
