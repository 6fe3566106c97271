"""Handles splats that cannot be drawn: real files contain NaN, infinities and zero-length rotations.

Each parser ends with a check. The usual one, :meth:`Splats.checked`, refuses the file and names the first bad value;
:class:`DropBroken` leaves such splats out and reports their number.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from cags_common.errors import SceneError
from cags_common.splats import Splats, beyond_bounds

Check: TypeAlias = Callable[[Splats, str], Splats]
"""Takes parsed splats and the file's name; returns checked splats or raises :class:`SceneError`."""

REPAIRS = ("none", "drop")

SHORTEST_QUATERNION = 1e-12

_log = logging.getLogger(__name__)
_said: set[tuple[str, int]] = set()


def drawable(splats: Splats) -> NDArray[np.bool_]:
    """Which splats [n] can be drawn: all values finite and within their bounds, rotation not of length zero.

    An opacity logit may be infinite.
    """
    good: NDArray[np.bool_] = np.linalg.norm(splats.quats.astype(np.float64), axis=1) >= SHORTEST_QUATERNION
    for name, array in splats.arrays():
        bad = np.isnan(array) if name == "logit_opacities" else ~np.isfinite(array)
        good &= ~bad.reshape(len(array), -1).any(axis=1) & ~beyond_bounds(name, array)
    return good


class DropBroken:
    """A check that leaves out splats that cannot be drawn, and remembers which rows it kept."""

    def __init__(self) -> None:
        self.kept: NDArray[np.int32] = np.zeros(0, np.int32)
        """Indices of the rows of the last file that were kept."""

    def __call__(self, splats: Splats, source: str) -> Splats:
        """The drawable splats, checked. Logs how many were left out, once per file and process."""
        with np.errstate(all="ignore"):
            good = drawable(splats)
        self.kept = np.flatnonzero(good).astype(np.int32)
        gone = len(good) - len(self.kept)
        if gone == len(good):
            raise SceneError(f"{source}: all of its {gone} splats have invalid values; give another file")
        if gone and (source, gone) not in _said:
            _said.add((source, gone))
            _log.warning(
                "%s: left out %d of %d splats: values that are not finite or beyond bounds, or no rotation",
                source,
                gone,
                len(good),
            )
        return (splats.take(good) if gone else splats).checked(source)
