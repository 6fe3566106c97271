"""Whole frames: drawn and corrected in one go, by scenes that can.

A client's frame can be made step by step, a rendered view and then a corrector; each step's pictures lie in memory.
A scene on another device would have to bring them all down. A :class:`FrameScene` does everything where the splats are
and gives out the picture to show; what it is made of comes when somebody looks at it.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Protocol, runtime_checkable

import numpy as np

from cags_common.correction.base import CorrectSettings, Reference, veto_shape
from cags_common.correction.changed import Spheres, changed_cells
from cags_common.geometry import F32, Camera, Intrinsics
from cags_common.raster.base import DepthKind, Footprint, RenderedView, RenderOptions


@dataclass(frozen=True, eq=False)
class Correction:
    """What is to be added to a frame, and where less of it."""

    reference: Reference
    client: Intrinsics
    """Intrinsics of the display, which set the footprint of the client's render from the reference camera."""
    settings: CorrectSettings = field(default_factory=CorrectSettings)
    changed: Spheres | None = None
    """Splats that changed since the reference was made: where they are seen, nothing is added."""
    stale: float = 0.0
    """Share of the confidence that is taken away everywhere, in [0, 1]."""

    def own_drawing(self, options: RenderOptions) -> RenderOptions:
        """How the client's view from the reference's camera is drawn, where its frames are with ``options``."""
        footprint = Footprint.of(self.client, self.reference.camera.intrinsics)
        return replace(options, depth=DepthKind.NONE, contribution=False, footprint=footprint)

    def veto(self, view: RenderedView, camera: Camera) -> F32 | None:
        """Of a ``view`` with depth from ``camera``, where it shows what changed or is too old; None: nowhere.

        Pixels of little opacity count as holes: what is behind them shines through.
        """
        veto = None
        if self.changed is not None:
            assert view.depth is not None, "corrected views have depth"
            thin = view.alpha < self.settings.hole_alpha
            veto = changed_cells(self.changed, camera, np.where(thin, np.float32(np.inf), view.depth))
        if self.stale <= 0:
            return veto
        stale = np.float32(self.stale)
        return np.full(veto_shape(camera), stale) if veto is None else np.maximum(veto, stale)


class FramePictures(Protocol):
    """A frame's picture and what it was made of. Whatever is looked at stays as it was when the frame was drawn."""

    @property
    def size(self) -> tuple[int, int]:
        """Rows and columns that the frame was worked out at: [h, w] below."""
        ...

    @property
    def rgb(self) -> F32:
        """[H, W, 3] in [0, 1]: what is shown."""
        ...

    @property
    def drawn(self) -> F32:
        """[h, w, 3] in [0, 1]: the client's own render."""
        ...

    @property
    def alpha(self) -> F32:
        """[h, w] in [0, 1]."""
        ...

    @property
    def depth(self) -> F32 | None:
        """[h, w] camera-space z, world units; +inf where void. None where nothing needed it."""
        ...

    @property
    def confidence(self) -> F32 | None:
        """[h, w] in [0, 1]: how much of what the reference says was added; None where none was used."""
        ...


@runtime_checkable
class FrameScene(Protocol):
    """A :class:`~cags_common.raster.base.RasterScene` that makes whole frames."""

    def frame(
        self, camera: Camera, options: RenderOptions, correction: Correction | None, display: Camera | None = None
    ) -> FramePictures | None:
        """The frame from ``camera``; None where it cannot be made in one go now (then step by step).

        ``display``: the camera that ``camera`` is :func:`~cags_common.raster.halving.halved` of; the picture is brought
        up to its size.
        """
        ...
