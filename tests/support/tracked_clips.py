"""Clips of which it is known which splat is which, and how well linking finds it out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cags_common.splats import Splats
from cags_encoder.scenes import open_scene
from cags_encoder.tracks.linking import Looks, Tracks, link

TrueFrame = tuple[Splats, np.ndarray]
"""A frame and the identity of each row."""


@dataclass(frozen=True)
class LinkScore:
    """Of all frames of a clip but the first."""

    found: float
    """Share of the splats that continue which were linked with what they continue."""
    false: float
    """Share of the links that are wrong."""


def linked(frames: list[TrueFrame]) -> LinkScore:
    """How well the splats of ``frames`` are linked."""
    splats, before = frames[0]
    tracks = Tracks.begun(Looks.of(splats))
    continuing = right = links = 0
    for after, ids in frames[1:]:
        looks = Looks.of(after)
        rows = link(tracks, looks)
        taken = rows[rows >= 0]
        assert len(np.unique(taken)) == len(taken)
        continuing += int(np.isin(ids, before).sum())
        right += int((before[taken] == ids[rows >= 0]).sum())
        links += len(taken)
        tracks, before = tracks.continued(looks, rows), ids
    return LinkScore(right / max(continuing, 1), 1 - right / max(links, 1))


def disguised(spec: str, shuffle: bool = True) -> list[TrueFrame]:
    """All frames of a generated scene, of which rows are shuffled and identities kept aside."""
    plain, scene = (
        open_scene(spec.replace(",quantise=sog", "").replace(",quantise=spz", "")),
        open_scene(spec + (",shuffle=1" if shuffle else "")),
    )
    frames = []
    for k in range(len(plain)):
        ids = plain.ids(k)
        assert ids is not None
        order = scene.order(k, len(ids)) if shuffle else np.arange(len(ids))  # type: ignore[attr-defined]
        frames.append((scene.frame(k), ids[order]))
    return frames
