"""How much worse a picture gets while updates are missing, measured by rendering the decoder's copy with old values.

Rate control weighs updates against motion and detail by it. It cannot be estimated from the changes of single splats:
quantisation errors are random and neighbours compensate for each other, but outdated attributes are all wrong in the
same direction. Where all splats of a surface shrink, holes open.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from cags_common.geometry import Camera
from cags_common.metrics import covered_mask
from cags_common.raster import DepthKind, Rasteriser, RenderedView, RenderOptions
from cags_common.splats import Ids, Splats
from cags_encoder.tracks.rows import SplatTable

LAGS = (1, 2, 4, 8, 16)
"""Numbers of frames for which updates are missing, including the first."""

LOOKS = 3
"""Number of parts of a clip; the first update in each is examined."""

_OPTIONS = RenderOptions(depth=DepthKind.NONE, contribution=True)


@dataclass(frozen=True, eq=False)
class _Lacked:
    """Updates of one frame, taken as missing."""

    frame: int
    ids: Ids  # [n]
    changed: Mapping[str, NDArray[np.bool_]]  # column -> [n]
    old: Splats  # [n] as they were


@dataclass
class _Sum:
    error: float = 0.0  # squared, over pixels
    pixels: float = 0.0  # that the splats of the updates make up


@dataclass(eq=False)
class Outdated:
    """Measures it at a few frames of a clip, from a few ``cameras``."""

    cameras: Sequence[Camera]
    rasteriser: Rasteriser
    frames: int
    """Of the clip."""
    _lacked: _Lacked | None = field(default=None, init=False)
    _next: int = field(default=0, init=False)
    """The first frame whose updates may be looked at next."""
    _sums: dict[int, _Sum] = field(default_factory=dict, init=False)

    def restart(self) -> None:
        """The decoder forgets its splats."""
        self._lacked = None

    def wants(self, frame: int) -> bool:
        """Whether to call :meth:`lack` with the updates of ``frame``."""
        return self._lacked is None and frame >= self._next

    def lack(self, frame: int, ids: Ids, changed: Mapping[str, NDArray[np.bool_]], old: Splats) -> None:
        """At ``frame`` the ``changed`` columns [n] of ``ids`` [n] get other values than the ``old`` ones."""
        self._lacked = _Lacked(frame, ids, changed, old)
        self._next = frame + max(self.frames // LOOKS, LAGS[-1])

    def look(self, frame: int, held: SplatTable) -> None:
        """Compare what is ``held`` at ``frame``, updates included, with the same without the missing ones."""
        lacked = self._lacked
        if lacked is None:
            return
        lag = frame - lacked.frame + 1
        if lag in LAGS:
            self._compare(self._sums.setdefault(lag, _Sum()), lacked, held)
        if lag >= LAGS[-1]:
            self._lacked = None

    def _compare(self, found: _Sum, lacked: _Lacked, held: SplatTable) -> None:
        alive = np.flatnonzero(held.alive).astype(np.int32)
        there = held.holds(lacked.ids)
        rows = np.searchsorted(alive, lacked.ids[there])
        true = held.take(alive)
        stale = dict(true.arrays())
        for column, mask in lacked.changed.items():
            now = mask[there]
            stale[column] = stale[column].copy()
            stale[column][rows[now]] = getattr(lacked.old, column)[there][now]
        for whole, without in zip(self._draw(true), self._draw(replace(true, **stale)), strict=True):
            assert whole.contribution is not None
            mask = covered_mask(np.maximum(whole.alpha, without.alpha))
            off = np.clip(whole.rgb, 0, 1) - np.clip(without.rgb, 0, 1)
            found.error += float(np.square(off)[mask].mean(axis=1).sum())
            made_up = whole.contribution
            found.pixels += float(mask.sum() * made_up[rows].sum() / max(made_up.sum(), 1e-9))

    def _draw(self, splats: Splats) -> list[RenderedView]:
        scene = self.rasteriser.load(splats)
        return [scene.render(camera, _OPTIONS) for camera in self.cameras]

    @property
    def psnr_db(self) -> tuple[tuple[int, float], ...]:
        """(frames, PSNR) by rising frames, over what the splats of updates make up of a picture; empty without any."""
        sums = sorted((lag, found) for lag, found in self._sums.items() if found.pixels > 0)
        return tuple((lag, round(-10 * math.log10(found.error / found.pixels + 1e-9), 3)) for lag, found in sums)
