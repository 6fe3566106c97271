"""Whole frames, drawn and corrected in one submission by scenes that support it.

A client's frame can be made in steps: a render and then a corrector, with all intermediate pictures in memory. A scene
on another device would have to transfer them all. A :class:`FrameScene` makes the whole frame on the device and
returns the displayed picture; intermediate pictures are transferred on request.
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
    """The correction to add to a frame, and where to reduce it."""

    reference: Reference
    client: Intrinsics
    """Intrinsics of the display, which set the footprint of the client's render from the reference camera."""
    settings: CorrectSettings = field(default_factory=CorrectSettings)
    changed: Spheres | None = None
    """Splats changed since the reference was made; nothing is added where they are visible."""
    stale: float = 0.0
    """Share of the confidence to remove everywhere, in [0, 1]."""

    def own_drawing(self, options: RenderOptions) -> RenderOptions:
        """Options for the client's render from the reference camera, given the ``options`` of its frames."""
        footprint = Footprint.of(self.client, self.reference.camera.intrinsics)
        return replace(options, depth=DepthKind.NONE, contribution=False, footprint=footprint)

    def veto(self, view: RenderedView, camera: Camera) -> F32 | None:
        """Veto for a ``view`` with depth from ``camera``: changed splats and age; None for none.

        Pixels of low opacity count as holes, because splats behind them are visible.
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
    """A frame's picture and its intermediate pictures, as they were when the frame was drawn."""

    @property
    def size(self) -> tuple[int, int]:
        """Rows and columns of the render: [h, w] below."""
        ...

    @property
    def rgb(self) -> F32:
        """[H, W, 3] in [0, 1]: the displayed picture."""
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
        """[h, w] camera-space z, world units; +inf where void. None if no pass needed it."""
        ...

    @property
    def confidence(self) -> F32 | None:
        """[h, w] in [0, 1]: share of the reference's correction that was added; None without a reference."""
        ...


@runtime_checkable
class FrameScene(Protocol):
    """A :class:`~cags_common.raster.base.RasterScene` that can make whole frames."""

    def frame(
        self, camera: Camera, options: RenderOptions, correction: Correction | None, display: Camera | None = None
    ) -> FramePictures | None:
        """The frame from ``camera``; None if it must be made in steps now.

        If ``camera`` is :func:`~cags_common.raster.halving.halved`, ``display`` is the full camera, and the picture is
        enlarged to its size.
        """
        ...
