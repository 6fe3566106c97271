"""The restoration seam: the colour-distorted picture and the aligned reference in, the picture to show out."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from cags_client.frame.align.base import Aligned
from cags_common.bundle.manifest import Manifest
from cags_common.geometry import F32
from cags_common.passes import Pass

ALIGNED = frozenset({Pass.ALIGNMENT, Pass.EROSION})
"""What restorers need: the aligned colours, filled where the reference does not see."""


@dataclass(frozen=True, eq=False)
class RestoreInput:
    """What a restorer sees of one frame."""

    distorted: F32  # [H, W, 3] in [0, 1]: the client's own render, premultiplied over black
    aligned: Aligned
    level: float
    """Detail of what is on screen in [0, 1] (:func:`level_of`). 0: all at the base; 1: all at the top of the ladder."""


def level_of(lod_mean: float, info: Manifest) -> float:
    """How far up the ladder a mean LoD of the splats in view (``Shown.lod_mean``) is, in [0, 1] and in decibels: the
    share that its levels have of what all levels of the content win, as the encoder measured it.

    Where it did not, the root of the share of levels: of what was measured that is near. 0 where nothing is in view
    (NaN): what a reference shows there is all there is. 1 on a ladder of one level.
    """
    if math.isnan(lod_mean):
        return 0.0
    if info.lods == 1:
        return 1.0
    won = np.cumsum([0.0, *(max(gain, 0.0) for gain in info.lod_gains_db)])
    if won[-1] <= 0:
        return math.sqrt(lod_mean / (info.lods - 1))
    return float(np.interp(lod_mean, np.arange(len(won)), won) / won[-1])


class Restorer(Protocol):
    """Colour restoration. Where ``aligned.confidence`` is 0 the reference says nothing about a pixel."""

    @property
    def name(self) -> str:
        """Name in the registry."""
        ...

    @property
    def needs(self) -> frozenset[Pass]:
        """What it looks at: alignment, erosion (of aligned colours)."""
        ...

    @property
    def replaces(self) -> bool:
        """Whether its picture stands in place of the client's own: it then runs at the highest LoD too."""
        ...

    def restore(self, inputs: RestoreInput) -> F32:
        """The picture to show, [H, W, 3] float32, finite, in [0, 1]. The inputs are not changed."""
        ...
