"""Comparison of the scene with a client's copy of it, from one camera.

A :class:`ComparingScene` draws and subtracts both on its device; :class:`StagedViews` compares two given pictures.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np

from cags_common.correction.compander import compand_by_table
from cags_common.geometry import F32, Camera
from cags_common.raster.base import RasterScene, RenderOptions


class Look(StrEnum):
    """One of the pictures of :class:`ComparedViews`."""

    TRUTH = "truth"
    LACK = "lack"
    COMPANDED = "companded"


class ComparedViews(Protocol):
    """Pictures of one comparison."""

    @property
    def truth(self) -> F32:
        """[h, w, 3] in [0, 1]: the scene."""
        ...

    @property
    def lack(self) -> F32:
        """[h, w, 3] in [-1, 1]: the scene minus the client's picture."""
        ...

    @property
    def compared(self) -> bool:
        """Whether the client's copy was compared and is not empty."""
        ...

    def companded(self, knee: float) -> F32:
        """[h, w, 3] in [0, 1]: ``lack`` after the compander (:mod:`.compander`)."""
        ...

    @property
    def depth(self) -> F32 | None:
        """[h, w] camera-space z of the client's copy, +inf where void; None if it was not drawn."""
        ...


class DrawnViews(ComparedViews, Protocol):
    """Compared views that were rendered for the comparison."""

    @property
    def contribution(self) -> F32:
        """[N] contributions of the scene's splats, in pixels."""
        ...


@runtime_checkable
class ComparingScene(Protocol):
    """A :class:`~cags_common.raster.base.RasterScene` that can compare itself on its device."""

    def compared(
        self, held: RasterScene, camera: Camera, options: RenderOptions, *, knee: float, looks: Collection[Look]
    ) -> DrawnViews | None:
        """Compare the scene with ``held``, a client's copy, in one submission; None if that is not possible now.

        ``looks`` are the pictures that will certainly be needed, ``knee`` is the likely knee of the compander. Other
        pictures are computed on request.
        """
        ...


@dataclass(frozen=True, eq=False)
class StagedViews:
    """Given pictures [h, w, 3]; ``mirror`` is None if the client's copy is empty or not compared."""

    scene: F32
    mirror: F32 | None
    depth: F32 | None = None
    """[h, w] of the client's copy; None: not drawn."""

    @cached_property
    def truth(self) -> F32:
        """The scene clipped to the display's range."""
        return np.clip(self.scene, 0, 1)

    @cached_property
    def lack(self) -> F32:
        """The whole scene if the client's copy is empty."""
        return self.truth if self.mirror is None else self.truth - np.clip(self.mirror, 0, 1)

    @property
    def compared(self) -> bool:
        """Whether there is a picture of the client's copy."""
        return self.mirror is not None

    def companded(self, knee: float) -> F32:
        """See :class:`ComparedViews`."""
        return compand_by_table(self.lack, knee)
