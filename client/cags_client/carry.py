"""References of another media frame, carried to the frame on display, by the client's own views of both:

    carried = own_now + (1 - b) w (reference - own_then) + b (reference - own_now),
    w = min(A, B) / (min(A, B) + CAUTION * C),    b = max(0, 1 - B / A),

with A and B the local mean powers of (reference - own_then) and (reference - own_now), and C that of (own_now -
own_then), what has visibly changed: moved parts where they were and where they are, recoloured ones, a cut. The views
are through one camera, so what stands still differs by nothing at all and keeps its whole correction (w = 1, b = 0),
while nothing is said about what has changed by much more than the correction is worth. Where the splats of now look
more like the reference than those of then do (b), they had been out of date, and what is still wrong in them counts.
Last, no correction may stand out: what the client was not sent in time it cannot know to have moved, and a reference is
right about that for its own frame alone. Where min(A, B) is more than PLAUSIBLE / age times its median, which
quantisation seldom is and a misplaced part is by far, the correction falls in proportion.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

import cags_kernels
from cags_client.align import ReferencePicture
from cags_common.geometry import F32
from cags_common.raster.base import RasterScene, RenderedView, RenderOptions
from cags_common.store.gof_store import GofStore

RADIUS_PX = 2
"""Radius, in reference pixels, of the local powers: that of the closed form's local fit."""

CAUTION = 3.0
"""Weight of what has changed against what the correction is worth."""

PLAUSIBLE = 64.0
"""Power of a correction against the median of the picture's, times the frames that have gone by, that is too much."""

VISIBLE_POWER = 1e-6
"""Of a correction of less than half a step of 8 bits: void, or nothing to correct."""

LEAST_POWER = 1e-12


def carried(reference: F32, then: F32, now: F32, age: int = 1, threads: int = 1) -> F32:
    """``reference`` [h, w, 3] as it would look ``age`` frames later, by the client's own views of both; in [0, 1]."""
    if not cags_kernels.native_available():
        return carried_as_defined(reference, then, now, age)
    from cags_kernels import align as kernels

    parameters = kernels.CarryParameters(RADIUS_PX, CAUTION, PLAUSIBLE / age, VISIBLE_POWER, threads)
    return kernels.carry(reference, then, now, parameters)


def carried_as_defined(reference: F32, then: F32, now: F32, age: int = 1) -> F32:
    """What :func:`carried` gives, in the terms of the module's text; it runs where the kernels are not installed."""
    then, now = then.clip(0.0, 1.0), now.clip(0.0, 1.0)
    residual, against_now = reference - then, reference - now
    a, b, changed = _local_power(residual), _local_power(against_now), _local_power(now - then)
    a += np.float32(LEAST_POWER)
    worth = np.minimum(a, b + np.float32(LEAST_POWER))
    better = np.maximum(1 - b / a, np.float32(0))
    plausible = np.minimum(np.float32(PLAUSIBLE / age * _median(worth)) / worth, np.float32(1))
    residual *= ((1 - better) * worth / (worth + np.float32(CAUTION) * changed))[..., None]
    residual += better[..., None] * against_now
    residual *= plausible[..., None]
    residual += now
    return np.clip(residual, 0.0, 1.0, out=residual)


def _median(power: F32) -> float:
    """Of the pixels where there is anything to correct; every fourth row is looked at."""
    rows = power[::4]
    shown = rows[rows > VISIBLE_POWER]
    return float(np.median(shown)) if shown.size else VISIBLE_POWER


def _local_power(picture: F32) -> F32:
    size = (2 * RADIUS_PX + 1,) * 2
    power = np.einsum("ijk,ijk->ij", picture, picture)
    mean = np.asarray(cv2.boxFilter(power, -1, size, borderType=cv2.BORDER_REFLECT), dtype=np.float32)
    return np.maximum(mean, np.float32(0))


@dataclass(frozen=True, eq=False)
class OnDisplay:
    """What the client holds at the moment, and a number by which to tell whether that has changed."""

    scene: RasterScene
    store: GofStore
    changes: int
    """Counts every change of the scene."""


@dataclass(frozen=True, eq=False)
class _View:
    """The client's own view of a reference, and what tells whether it would come out the same again."""

    reference: ReferencePicture
    key: tuple[int | RenderOptions, ...]
    picture: RenderedView

    def still(self, reference: ReferencePicture, key: tuple[int | RenderOptions, ...]) -> bool:
        return self.reference is reference and self.key == key


class ReferenceViews:
    """The client's splats from a reference's camera: drawn anew where they changed."""

    def __init__(self) -> None:
        self._now: _View | None = None

    def now(self, reference: ReferencePicture, held: OnDisplay, options: RenderOptions) -> RenderedView:
        """As the scene is. A reference's first view has the splats' contributions, which take a fifth of its time."""
        key = (held.changes, options)
        if self._now is None or not self._now.still(reference, key):
            first = self._now is None or self._now.reference is not reference
            picture = held.scene.render(reference.camera, replace(options, contribution=first))
            self._now = _View(reference, key, picture)
        return self._now.picture
