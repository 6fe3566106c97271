"""Splats with their own motion and lifetime, as in 4D models: one set for a whole clip.

A splat's position is a polynomial in the time since its centre, its rotation changes at a constant rate, and its
opacity rises and falls as a Gaussian of time (SpaceTime Gaussians, Li et al., CVPR 2024, equations 7 to 9).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cags_common.errors import SceneError
from cags_common.geometry import F32, F64
from cags_common.splats import Splats
from cags_encoder.formats.files import directed, quietly
from cags_encoder.formats.repair import Check, DropBroken

FAINTEST = 1.0 / 255.0
"""A splat of lower opacity is absent from a frame: common rasterisers do not draw it."""

MAX_LOGIT = 20.0


@dataclass(frozen=True, eq=False)
class TimedSplats:
    """N splats over time. All times have the same unit."""

    splats: Splats  # [N] at their centres in time, with their peak opacity
    centres: F64  # [N] time of peak opacity
    widths: F64  # [N] positive: time from the centre until opacity has fallen to 1/e of its peak
    motion: F32  # [N, order, 3] coefficients of powers 1, 2, ... of the time since the centre
    omega: F32  # [N, 4] change of the rotation's wxyz per unit of time, before normalisation

    def __len__(self) -> int:
        return len(self.splats)

    def take(self, rows: NDArray[np.intp] | NDArray[np.int32]) -> TimedSplats:
        """The splats at ``rows``."""
        parts = (self.centres[rows], self.widths[rows], self.motion[rows], self.omega[rows])
        return TimedSplats(self.splats.take(rows), *parts)

    def alive(self, time: float) -> NDArray[np.intp]:
        """Rows [n] of the splats visible at ``time``, ascending."""
        return np.flatnonzero(self._log_opacities(time) >= np.log(FAINTEST))

    def brightest(self, time: float) -> NDArray[np.intp]:
        """Row [1] of the most opaque splat at ``time``: used if no splat is visible."""
        return np.array([np.argmax(self._log_opacities(time))])

    @quietly
    def at(self, time: float, rows: NDArray[np.intp], source: str, check: Check = Splats.checked) -> Splats:
        """The splats of ``rows`` at ``time``; ``check`` decides what happens to those that cannot be drawn.

        Finite coefficients may give positions beyond any limit. Raises :class:`SceneError` naming ``source``.
        """
        since = time - self.centres[rows]
        means = self.splats.means[rows].astype(np.float64)
        for power in range(self.motion.shape[1]):
            means += self.motion[rows, power] * (since ** (power + 1))[:, None]
        quats = self.splats.quats[rows] + self.omega[rows] * since[:, None].astype(np.float32)
        opacity = np.exp(self._log_opacities(time)[rows])
        logits = np.log(opacity) - np.log1p(-np.minimum(opacity, 1 - 1e-9))
        moved = replace(
            self.splats.take(rows),
            means=means.astype(np.float32),
            quats=directed(quats),
            logit_opacities=np.clip(logits, -MAX_LOGIT, MAX_LOGIT).astype(np.float32),
        )
        return check(moved, source)

    def _log_opacities(self, time: float) -> F64:
        logits = np.clip(self.splats.logit_opacities.astype(np.float64), -30.0, 30.0)
        with np.errstate(over="ignore"):
            faded: F64 = -np.log1p(np.exp(-logits)) - np.square((time - self.centres) / self.widths)
        return faded


@quietly
def checked_times(timed: TimedSplats, source: str, drop: DropBroken | None) -> TimedSplats:
    """Check that all values of ``timed``, read from ``source``, are finite and its widths positive.

    Raises :class:`SceneError` naming the first bad splat, unless ``drop`` is given: then bad splats are left out.
    """
    columns: dict[str, NDArray[np.floating[Any]]] = {
        "motion": timed.motion,
        "omega": timed.omega,
        "centre in time": timed.centres,
    }
    good = np.ones(len(timed), bool)
    for name, values in columns.items():
        finite = np.isfinite(values.reshape(len(timed), -1)).all(axis=1)
        if drop is None and not finite.all():
            raise SceneError(_broken(source, name, int(np.argmin(finite))))
        good &= finite
    lasting = np.isfinite(timed.widths) & (timed.widths > 0)
    if drop is None:
        if not lasting.all():
            raise SceneError(_broken(source, "width in time", int(np.argmin(lasting))))
        return replace(timed, splats=timed.splats.checked(source))
    means = np.where((good & lasting)[:, None], timed.splats.means, np.float32(np.nan))
    splats = drop(replace(timed.splats, means=means), source)
    return replace(timed.take(drop.kept), splats=splats)


def _broken(source: str, name: str, row: int) -> str:
    return f"{source}: {name} of splat {row} cannot be used; repair the file, or give the scene's option repair=drop"
