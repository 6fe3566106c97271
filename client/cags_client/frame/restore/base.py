"""The restoration seam: the colour-distorted picture and the aligned reference in, the picture to show out."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from cags_client.frame.align.base import Aligned
from cags_common.bundle.manifest import Manifest
from cags_common.geometry import F32, F64
from cags_common.passes import Pass

ALIGNED = frozenset({Pass.ALIGNMENT, Pass.EROSION})
"""What restorers need: the aligned colours, filled where the reference does not see."""


@dataclass(frozen=True, eq=False)
class RestoreInput:
    """What a restorer sees of one frame."""

    distorted: F32  # [H, W, 3] in [0, 1]: the client's own render, premultiplied over black
    aligned: Aligned
    expected_db: float
    """PSNR that ``distorted`` is expected to have (:func:`expected_psnr_db`)."""


TYPICAL_BASE_DB, TYPICAL_TOP_DB = 27.0, 51.0
"""PSNR of the lowest and highest level of ladders that were measured; between them it rises as the root of the level.
"""


def expected_psnr_db(lod_mean: float, info: Manifest) -> float:
    """PSNR of pictures whose splats in view have a mean LoD of ``lod_mean`` (``Shown.lod_mean``), as the encoder
    measured it; typical values where it did not. 0 where nothing is in view (NaN): a reference knows more.
    """
    if math.isnan(lod_mean):
        return 0.0
    base_db = TYPICAL_BASE_DB if info.base_psnr_db is None else info.base_psnr_db
    won = np.cumsum([0.0, *(max(gain, 0.0) for gain in info.lod_gains_db)])
    if won[-1] > 0:
        return base_db + float(np.interp(lod_mean, np.arange(len(won)), won))
    share = lod_mean / (info.lods - 1) if info.lods > 1 else 1.0
    return base_db + math.sqrt(share) * max(TYPICAL_TOP_DB - base_db, 0.0)


def expected_errors(info: Manifest) -> F64:
    """Mean squared errors [lods], RGB in [0, 1], of pictures at each LoD, by :func:`expected_psnr_db`."""
    return np.array([10 ** (-expected_psnr_db(lod, info) / 10) for lod in range(info.lods)])


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
