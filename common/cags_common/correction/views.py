"""What a server compares: the scene and what a client shows of it, seen from one camera.

A :class:`ComparingScene` draws both where its splats are and subtracts them there; :class:`StagedViews` takes two
pictures that are at hand.
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
        """[h, w, 3] in [-1, 1]: it less what the client shows."""
        ...

    @property
    def compared(self) -> bool:
        """Whether the client shows anything, and was asked."""
        ...

    def companded(self, knee: float) -> F32:
        """[h, w, 3] in [0, 1]: ``lack`` as it is coded (:mod:`.compander`)."""
        ...


class DrawnViews(ComparedViews, Protocol):
    """Compared views that were rendered for the comparison."""

    @property
    def contribution(self) -> F32:
        """[N] what the scene's splats contribute, in pixels."""
        ...


@runtime_checkable
class ComparingScene(Protocol):
    """A :class:`~cags_common.raster.base.RasterScene` that is compared where its splats are."""

    def compared(
        self, held: RasterScene, camera: Camera, options: RenderOptions, *, knee: float, looks: Collection[Look]
    ) -> DrawnViews | None:
        """The scene against ``held``, what a client shows, in one go; None where that cannot be now.

        ``looks`` is what will be looked at for certain, ``knee`` that of the compander in all likelihood: other things
        come when they are asked for.
        """
        ...


@dataclass(frozen=True, eq=False)
class StagedViews:
    """Pictures [h, w, 3] that are at hand; ``mirror`` None: the client shows nothing, or is not compared with."""

    scene: F32
    mirror: F32 | None

    @cached_property
    def truth(self) -> F32:
        """The scene in the display's range."""
        return np.clip(self.scene, 0, 1)

    @cached_property
    def lack(self) -> F32:
        """All of it where the client shows nothing."""
        return self.truth if self.mirror is None else self.truth - np.clip(self.mirror, 0, 1)

    @property
    def compared(self) -> bool:
        """Whether there is a picture of the client's."""
        return self.mirror is not None

    def companded(self, knee: float) -> F32:
        """See :class:`ComparedViews`."""
        return compand_by_table(self.lack, knee)
