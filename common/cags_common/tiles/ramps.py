"""Attributes on their way from one value to the next.

An update says in how many frames its value is reached. Until then the attribute is interpolated linearly from its
predecessor: the value of the newest earlier update of the attribute, or that of the looks. So a colour that drifts is
sent once for many frames, and never jumps.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cags_common.geometry import F32

Rows = NDArray[np.intp]
Ids = NDArray[np.integer]
U8 = NDArray[np.uint8]

LONGEST_RAMP = 16
"""Largest number of frames in which an update reaches its value."""

AT_ONCE = 1
"""Number of frames of an update whose first frame shows its value."""

OF_LOOKS = -1
"""In place of the media frame of a predecessor: it is the looks' value."""


def share_of(time: float, begin: NDArray[np.int32], frames: U8) -> F32:
    """Share [m] of the way covered at ``time``, media frames, by ramps of ``frames`` frames [m] from ``begin`` [m] on.

    The first frame of a ramp has already covered ``1 / frames``. Every decoder computes the same bits.
    """
    passed = (time + 1.0 - begin) / frames.astype(np.float64)
    return np.minimum(passed, 1.0).astype(np.float32)


class Ramps:
    """The splats of which one attribute is on its way; rows are splat ids, each at most once."""

    def __init__(self, width: tuple[int, ...]) -> None:
        """``width`` is the shape of one splat's values."""
        self._ids: Rows = np.zeros(0, np.intp)  # ascending
        self._begin = np.zeros(0, np.int32)
        self._frames: U8 = np.zeros(0, np.uint8)
        self._since = np.zeros(0, np.int32)  # media frame of the predecessor
        self._from: F32 = np.zeros((0, *width), np.float32)
        self._to: F32 = np.zeros((0, *width), np.float32)

    def __len__(self) -> int:
        return len(self._ids)

    @property
    def nbytes(self) -> int:
        """Memory, bytes."""
        return sum(array.nbytes for array in vars(self).values())

    def clear(self) -> None:
        """Forget all."""
        self._keep(np.zeros(len(self._ids), bool))

    def drop(self, ids: Ids) -> None:
        """Forget ``ids``: their attribute has another value, at once."""
        _, at = self._found(ids)
        kept = np.ones(len(self._ids), bool)
        kept[at] = False
        self._keep(kept)

    def ends(self, ids: Ids, otherwise: F32) -> F32:
        """The values [n, ...] to which ``ids`` [n] are on their way; ``otherwise`` [n, ...] those of all others."""
        rows, at = self._found(ids)
        if not len(rows):
            return otherwise
        out = otherwise.copy()
        out[rows] = self._to[at]
        return out

    def put(self, ids: Rows, begin: int, frames: U8, values: tuple[F32, F32], since: NDArray[np.int32]) -> None:
        """``ids`` [n] are on their way from media frame ``begin`` on, for ``frames`` [n].

        ``values`` [n, ...] are those of the predecessors, which are of the media frames ``since`` [n], and the last.
        """
        self.drop(ids)
        old = vars(self).values()
        new = ids, np.full(len(ids), begin, np.int32), frames, since, *values
        joined = [np.concatenate([mine, added]) for mine, added in zip(old, new, strict=True)]
        self._take(joined, np.argsort(joined[0], kind="stable"))

    def refine(self, ids: Ids, frame: int, values: F32) -> NDArray[np.bool_]:
        """Set the last ``values`` [n, ...] of those of ``ids`` [n] that began at ``frame``; returns which [n] did."""
        rows, at = self._found(ids)
        mine = self._begin[at] == frame
        self._to[at[mine]] = values[rows[mine]]
        out = np.zeros(len(ids), bool)
        out[rows[mine]] = True
        return out

    def precede(self, ids: Ids, frame: int, values: F32) -> None:
        """An update of media ``frame`` has come with ``values`` [n, ...]: of ramps that begin later it is the
        predecessor, unless a newer one is known.
        """
        rows, at = self._found(ids)
        mine = (self._since[at] <= frame) & (frame < self._begin[at])
        self._from[at[mine]], self._since[at[mine]] = values[rows[mine]], frame

    def stand_on(self, ids: Ids, frame: int, values: F32) -> None:
        """Looks of media ``frame`` have come: they precede ramps whose predecessor is older."""
        rows, at = self._found(ids)
        mine = self._since[at] < frame
        self._from[at[mine]], self._since[at[mine]] = values[rows[mine]], OF_LOOKS

    def follows(self, ids: Ids, frame: int) -> bool:
        """Whether the update of media ``frame`` is the predecessor of any of ``ids``."""
        _, at = self._found(ids)
        return bool((self._since[at] == frame).any())

    def at(self, time: float) -> tuple[Rows, F32, NDArray[np.int32]]:
        """Ids [m], values [m, ...] at ``time`` and the media frames [m] in which they began; those that have reached
        their value are forgotten.
        """
        share = share_of(time, self._begin, self._frames)
        along = share.reshape(-1, *[1] * (self._to.ndim - 1))
        values = np.where(along >= 1, self._to, self._from + (self._to - self._from) * along)
        found = self._ids, values, self._begin
        self._keep(share < 1)
        return found

    def _found(self, ids: Ids) -> tuple[Rows, Rows]:
        """Which of ``ids`` are on their way, and where each is."""
        if not len(self._ids) or not len(ids):
            return np.zeros(0, np.intp), np.zeros(0, np.intp)
        at = np.minimum(np.searchsorted(self._ids, ids), len(self._ids) - 1)
        rows = np.flatnonzero(self._ids[at] == ids)
        return rows, at[rows]

    def _keep(self, mask: NDArray[np.bool_]) -> None:
        if not mask.all():
            self._take(list(vars(self).values()), np.flatnonzero(mask))

    def _take(self, arrays: list[NDArray[np.generic]], rows: Rows) -> None:
        for name, array in zip(vars(self), arrays, strict=True):
            setattr(self, name, array[rows])
