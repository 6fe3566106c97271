"""Attributes on their way from one value to the next.

An update says in how many frames its value is reached. Until then the attribute is interpolated linearly from its
predecessor: the value of the newest earlier update of the attribute, or that of the looks. So a colour that drifts is
sent once for many frames, and never jumps.
"""

from __future__ import annotations

from dataclasses import dataclass

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


_NOWHERE = -1


class Ramps:
    """The splats of which one attribute is on its way; rows are splat ids, each at most once.

    Ramps are stored in rows of their own, found by a table from ids to rows, so that the time of a call depends on the
    number of splats it names and not on all that are on their way.
    """

    def __init__(self, width: tuple[int, ...]) -> None:
        """``width`` is the shape of one splat's values."""
        self._place = np.full(1, _NOWHERE, np.int32)  # by id; the last one is nobody's
        self._rows = _Rows.of(0, width)
        self._taken = 0  # rows in use, those of forgotten splats among them
        self._count = 0

    def __len__(self) -> int:
        return self._count

    @property
    def nbytes(self) -> int:
        """Memory, bytes."""
        return sum(array.nbytes for array in (self._place, *vars(self._rows).values()))

    def clear(self) -> None:
        """Forget all."""
        self._place[:] = _NOWHERE
        self._taken = self._count = 0

    def drop(self, ids: Ids) -> None:
        """Forget ``ids``: their attribute has another value, at once."""
        rows, at = self._found(ids)
        if len(at):
            self._place[ids[rows]] = _NOWHERE
            self._rows.ids[at] = _NOWHERE
            self._count -= len(at)

    def ends(self, ids: Ids, otherwise: F32) -> F32:
        """The values [n, ...] to which ``ids`` [n] are on their way; ``otherwise`` [n, ...] those of all others."""
        rows, at = self._found(ids)
        if not len(rows):
            return otherwise
        out = otherwise.copy()
        out[rows] = self._rows.ends.take(at, axis=0)
        return out

    def put(self, ids: Rows, begin: int, frames: U8, values: tuple[F32, F32], since: NDArray[np.int32]) -> None:
        """``ids`` [n], each once, are on their way from media frame ``begin`` on, for ``frames`` [n].

        ``values`` [n, ...] are those of the predecessors, which are of the media frames ``since`` [n], and the last.
        """
        if not len(ids):
            return
        self._reach(int(ids.max()))
        places = self._place.take(ids)
        fresh = np.flatnonzero(places == _NOWHERE)
        self._make_room(len(fresh))
        end = self._taken + len(fresh)
        places[fresh] = np.arange(self._taken, end, dtype=np.int32)
        at = slice(self._taken, end) if len(fresh) == len(ids) else places
        self._taken, self._count = end, self._count + len(fresh)
        self._place[ids] = places
        rows, (starts, ends) = self._rows, values
        rows.ids[at], rows.begin[at], rows.frames[at], rows.since[at] = ids, begin, frames, since
        rows.starts[at], rows.ends[at] = starts, ends

    def take_over(self, ids: Rows, begin: int, frames: U8, values: tuple[F32, F32], since: NDArray[np.int32]) -> None:
        """An update says where ``ids`` [n], each once, are on their way to from media frame ``begin`` on.

        Of those that began there, it refines the last values. Others begin at the values to which they were on their
        way, or at the shown ones. ``values`` [n, ...] are the shown ones and the last; the rest is as for :meth:`put`.
        """
        rows, at = self._found(ids)
        if not len(rows):
            self.put(ids, begin, frames, values, since)
            return
        shown, last = values
        mine = self._rows.begin[at] == begin
        self._rows.ends[at[mine]] = last[rows[mine]]
        starts = shown.copy()
        starts[rows] = self._rows.ends.take(at, axis=0)
        if mine.any():
            fresh = np.ones(len(ids), np.bool_)
            fresh[rows[mine]] = False
            self.put(ids[fresh], begin, frames[fresh], (starts[fresh], last[fresh]), since[fresh])
        else:
            self.put(ids, begin, frames, (starts, last), since)

    def precede(self, ids: Ids, frame: int, values: F32) -> None:
        """An update of media ``frame`` has come with ``values`` [n, ...]: of ramps that begin later it is the
        predecessor, unless a newer one is known.
        """
        rows, at = self._found(ids)
        mine = (self._rows.since[at] <= frame) & (frame < self._rows.begin[at])
        self._rows.starts[at[mine]], self._rows.since[at[mine]] = values[rows[mine]], frame

    def stand_on(self, ids: Ids, frame: int, values: F32) -> None:
        """Looks of media ``frame`` have come: they precede ramps whose predecessor is older."""
        rows, at = self._found(ids)
        mine = self._rows.since[at] < frame
        self._rows.starts[at[mine]], self._rows.since[at[mine]] = values[rows[mine]], OF_LOOKS

    def follows(self, ids: Ids, frame: int) -> bool:
        """Whether the update of media ``frame`` is the predecessor of any of ``ids``."""
        _, at = self._found(ids)
        return bool((self._rows.since[at] == frame).any())

    def at(self, time: float) -> tuple[Rows, F32, NDArray[np.int32]]:
        """Ids [m], values [m, ...] at ``time`` and the media frames [m] in which they began; those that have reached
        their value are forgotten.
        """
        if self._taken - self._count > self._count // 4:
            self._compact()
        now = self._rows.first(self._taken)
        share = share_of(time, now.begin, now.frames)
        done, there = np.flatnonzero(share >= 1), np.flatnonzero(now.ids != _NOWHERE)
        values = now.ends - now.starts
        values *= share.reshape(-1, *[1] * (now.ends.ndim - 1))
        values += now.starts
        values[done] = now.ends.take(done, axis=0)
        found = now.ids.take(there).astype(np.intp), values.take(there, axis=0), now.begin.take(there)
        ended = now.ids.take(done)
        self._place[ended[ended != _NOWHERE]] = _NOWHERE
        now.ids[done] = _NOWHERE
        self._count -= int(np.count_nonzero(ended != _NOWHERE))
        return found

    def _found(self, ids: Ids) -> tuple[Rows, Rows]:
        """Which of ``ids`` are on their way, and where each is."""
        if not self._count or not len(ids):
            return np.zeros(0, np.intp), np.zeros(0, np.intp)
        at = self._place.take(ids, mode="clip")
        rows = np.flatnonzero(at != _NOWHERE)
        return rows, at[rows].astype(np.intp)

    def _compact(self) -> None:
        """Remove the rows of forgotten splats."""
        rows = np.flatnonzero(self._rows.ids[: self._taken] != _NOWHERE)
        for array in vars(self._rows).values():
            array[: len(rows)] = array.take(rows, axis=0)
        self._place[self._rows.ids[: len(rows)]] = np.arange(len(rows), dtype=np.int32)
        self._taken = len(rows)

    def _reach(self, last: int) -> None:
        """Extend the table to all ids up to ``last``."""
        if last > len(self._place) - 2:
            longer = np.full(max(last + 2, 2 * len(self._place)), _NOWHERE, np.int32)
            longer[: len(self._place)] = self._place
            self._place = longer

    def _make_room(self, more: int) -> None:
        if self._taken + more > len(self._rows.ids):
            self._rows = self._rows.longer(max(self._taken + more, 2 * self._taken))


@dataclass(eq=False)
class _Rows:
    """Ramps, one a row."""

    ids: NDArray[np.int32]  # [n]; -1: forgotten
    begin: NDArray[np.int32]  # [n] media frames
    frames: U8  # [n]
    since: NDArray[np.int32]  # [n] media frame of the predecessor
    starts: F32  # [n, ...] value of the predecessor
    ends: F32  # [n, ...]

    @staticmethod
    def of(n: int, width: tuple[int, ...]) -> _Rows:
        numbers = (np.full(n, _NOWHERE, np.int32), np.zeros(n, np.int32), np.ones(n, np.uint8), np.zeros(n, np.int32))
        return _Rows(*numbers, np.zeros((n, *width), np.float32), np.zeros((n, *width), np.float32))

    def first(self, n: int) -> _Rows:
        """Views of the first ``n``."""
        return _Rows(**{name: array[:n] for name, array in vars(self).items()})

    def longer(self, n: int) -> _Rows:
        """The same with room for ``n``."""
        made = _Rows.of(n, self.ends.shape[1:])
        for name, array in vars(self).items():
            getattr(made, name)[: len(array)] = array
        return made
