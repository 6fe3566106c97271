"""References of another media frame, carried to the frame on display.

A reference shows the scene of its own frame t_r; what is wrong in the client's splats is *reference - own view as
of t_r*. Against the splats of a later frame it would show what has moved, not what is wrong: a moving part would be
painted where it was. So the client draws its splats from the reference's camera twice, as of t_r (undoing the changes
of content since, :class:`~cags_client.past.SplatPast`) and as of now, and hands on the reference as it would look now,

    carried = own_now + weight * (reference - own_then),    weight = E / (E + CAUTION * C),

with E the local mean power of (reference - own_then) and C that of (own_now - own_then), what has visibly changed:
moved parts where they were and where they are, recoloured ones, a cut. Both views are through one camera, so what
stands still differs by nothing at all and keeps its whole correction, while nothing is said about what has changed by
much more than the correction is worth. Everything behind (alignment, its z-test, restoration, the adapter) then works
on one frame.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from cags_client.align import ReferencePicture
from cags_client.gof_store import GofStore
from cags_client.past import EarlierGroups
from cags_common.geometry import F32
from cags_common.raster.base import Rasteriser, RasterScene, RenderedView, RenderOptions

RADIUS_PX = 2
"""Radius, in reference pixels, of the local powers: that of the closed form's local fit."""

CAUTION = 3.0
"""Weight of what has changed against what the correction is worth."""

LEAST_POWER = 1e-12


def carried(reference: F32, then: F32, now: F32) -> F32:
    """``reference`` [h, w, 3] as it would look now, by the client's own views of both frames; all in [0, 1]."""
    residual = reference - then
    worth, changed = _local_power(residual), _local_power(now - then)
    worth += np.float32(LEAST_POWER)
    residual *= (worth / (worth + np.float32(CAUTION) * changed))[..., None]
    residual += now
    return np.clip(residual, 0.0, 1.0, out=residual)


def _local_power(picture: F32) -> F32:
    size = (2 * RADIUS_PX + 1,) * 2
    power = np.einsum("ijk,ijk->ij", picture, picture)
    mean = np.asarray(cv2.boxFilter(power, -1, size, borderType=cv2.BORDER_REFLECT), dtype=np.float32)
    return np.maximum(mean, np.float32(0))


@dataclass(frozen=True, eq=False)
class Held:
    """What the client holds at the moment, and two numbers by which to tell whether that has changed."""

    scene: RasterScene
    store: GofStore
    changes: int
    """Counts every change of the scene."""
    corrections: int
    """Counts the changes of its colours by the adapter."""
    restore: Callable[[NDArray[np.intp]], None]
    """Brings rows of the scene back to what is on display."""


@dataclass(frozen=True, eq=False)
class _View:
    """The client's own view of a reference, and what tells whether it would come out the same again."""

    reference: ReferencePicture
    key: tuple[int | RenderOptions, ...]
    picture: RenderedView

    def still(self, reference: ReferencePicture, key: tuple[int | RenderOptions, ...]) -> bool:
        return self.reference is reference and self.key == key


class ReferenceViews:
    """The client's splats from a reference's camera, as of now and as of its frame: drawn anew where they changed."""

    def __init__(self, rasteriser: Rasteriser, earlier: EarlierGroups) -> None:
        self._rasteriser, self._earlier = rasteriser, earlier
        self._now: _View | None = None
        self._then: _View | None = None

    def usable(self, reference: ReferencePicture, store: GofStore) -> bool:
        """Whether the client can still tell what it would have seen at the reference's frame."""
        if self._then is not None and self._then.reference is reference:
            return True
        return store.past.knows(reference.frame) or self._earlier.knows(reference.frame)

    def now(self, reference: ReferencePicture, held: Held, options: RenderOptions) -> RenderedView:
        """As the scene is."""
        key = (held.changes, options)
        if self._now is None or not self._now.still(reference, key):
            self._now = _View(reference, key, held.scene.render(reference.camera, options))
            if held.store.past.knows(reference.frame) and not held.store.past.changed_since(reference.frame):
                self._then = _View(reference, self._quality(held, options), self._now.picture)
        return self._now.picture

    def carried(
        self, reference: ReferencePicture, held: Held, options: RenderOptions
    ) -> tuple[ReferencePicture, RenderedView]:
        """``reference`` as it would look now, and the client's own view of that. Only for a :meth:`usable` one.

        No other thread may draw the scene meanwhile.
        """
        own = self.now(reference, held, options)
        then = self._as_of_reference(reference, held, options)
        if then is own:
            return reference, own
        pictures = reference.rgb, then.rgb.clip(0.0, 1.0), own.rgb.clip(0.0, 1.0)
        return replace(reference, rgb=carried(*pictures)), own

    def _as_of_reference(self, reference: ReferencePicture, held: Held, options: RenderOptions) -> RenderedView:
        key, known = self._quality(held, options), held.store.past.knows(reference.frame)
        then = self._then
        if then is None or then.reference is not reference or (known and then.key != key):
            draw = self._undone if known else self._of_earlier_group
            then = self._then = _View(reference, key, draw(reference, held, options))
        return then.picture

    def _undone(self, reference: ReferencePicture, held: Held, options: RenderOptions) -> RenderedView:
        before = held.store.past.as_of(reference.frame)
        assert before is not None, "now() keeps the view of a reference after which nothing has changed"
        rows, splats = before
        held.scene.update(rows, splats)
        try:
            return held.scene.render(reference.camera, options)
        finally:
            held.restore(rows)

    def _of_earlier_group(self, reference: ReferencePicture, _: Held, options: RenderOptions) -> RenderedView:
        scene = self._rasteriser.load(self._earlier.as_of(reference.frame))
        return scene.render(reference.camera, options)

    @staticmethod
    def _quality(held: Held, options: RenderOptions) -> tuple[int | RenderOptions, ...]:
        """What a view as of some frame depends on: how well the splats are held, not which frame is on display."""
        return (held.store.improved, held.corrections, options)
