"""Which splat of one frame is which of the next.

Sources that know identities give them. For others rows are compared with the frame before: by row when most rows agree,
else by nearest attributes. Frames that share too little start a new group of frames.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cags_common.errors import SceneError
from cags_common.geometry import F32, F64
from cags_common.splats import SH_C0, Ids, Splats
from cags_encoder.frames.rows import same_rows

MIN_OVERLAP = 0.25
"""Share of rows that must be found again; with fewer a key frame costs no more than the differences."""

MIN_AGREEMENT = 0.5
"""Share of rows that must look like the same row of the frame before for rows to be taken as identities."""

NEAR_RADII = 3.0
"""A splat found again lies within this many of its own radii, or it is taken for a new one."""

SPACING_PROBES = 2_000
"""Splats whose nearest neighbour is looked up to find the typical spacing."""

COLOUR_WEIGHT = 4.0
"""Radii that a full change of colour counts for when splats are matched by attributes."""


class IdentityTracker:
    """Gives every row of every frame a persistent identity. Frames must come in order."""

    def __init__(self) -> None:
        self._ids: NDArray[np.int64] = np.zeros(0, np.int64)
        self._next = 0

    def identify(
        self, count: int, known: Ids | None, rows: NDArray[np.int64] | None, source: str
    ) -> tuple[NDArray[np.int64], bool]:
        """Identities [n] of a frame's ``count`` rows, and whether enough of the frame before was found again.

        ``known`` are identities that the source gives; otherwise ``rows`` says which row of the frame before each row
        continues (:func:`match_rows`), None in the first frame. ``source`` names the frame in errors. Raises
        :class:`SceneError` for identities that repeat.
        """
        if known is not None:
            ids = known.astype(np.int64)
            if len(np.unique(ids)) != count or ids.min(initial=0) < 0:
                raise SceneError(f"{source}: its splat identities must be distinct and not negative, one a splat")
            found = int(np.isin(ids, self._ids, assume_unique=True).sum())
        elif rows is None:
            self._next = count
            ids, found = np.arange(count), 0
        else:
            ids, found = self._continued(rows)
        self._ids = ids
        return ids, found >= MIN_OVERLAP * count

    def _continued(self, rows: NDArray[np.int64]) -> tuple[NDArray[np.int64], int]:
        """Identities, and how many rows were found again. Rows that were not take over those of lost rows.

        A splat that changes is sent whole, so that taking over an identity costs what a new one does, and nothing need
        be removed.
        """
        found = rows >= 0
        ids = np.full(len(rows), -1, np.int64)
        ids[found] = self._ids[rows[found]]
        lost = np.delete(self._ids, rows[found])
        fresh = np.flatnonzero(~found)
        shared = min(len(lost), len(fresh))
        ids[fresh[:shared]] = lost[:shared]
        more = len(fresh) - shared
        ids[fresh[shared:]] = np.arange(self._next, self._next + more)
        self._next += more
        return ids, int(found.sum())


def match_rows(before: Splats, after: Splats) -> NDArray[np.int64]:
    """For each splat of ``after`` [n] the row in ``before`` that it continues, or -1; no row is used twice."""
    if len(before) == len(after):
        agree = _agree(before, after)
        if agree.mean() >= MIN_AGREEMENT:
            return np.where(agree, np.arange(len(after)), -1)
    return _nearest(before, after)


def _radii(splats: Splats) -> F64:
    """Mean standard deviation of each splat [n], metres."""
    radii: F64 = np.exp(np.clip(splats.log_scales.astype(np.float64), -30, 30)).mean(axis=1)
    return radii


def _agree(before: Splats, after: Splats) -> NDArray[np.bool_]:
    shift = np.linalg.norm(after.means.astype(np.float64) - before.means, axis=1)
    colour = np.abs(after.sh0 - before.sh0).max(axis=1) * SH_C0
    near: NDArray[np.bool_] = shift + colour * COLOUR_WEIGHT * _radii(before) <= NEAR_RADII * _radii(before)
    return near | same_rows(before, after)


def _nearest(before: Splats, after: Splats) -> NDArray[np.int64]:
    """Mutually nearest neighbours in position and colour, in units of the typical radius or spacing."""
    from scipy.spatial import cKDTree

    unit = max(float(np.median(_radii(before))), _spacing(before), 1e-12)
    tree = cKDTree(_features(before, unit))
    distance, row = tree.query(_features(after, unit), workers=1)
    back = cKDTree(_features(after, unit)).query(_features(before, unit), workers=1)[1]
    mutual = back[row] == np.arange(len(after))
    near = distance * unit <= NEAR_RADII * np.maximum(_radii(before)[row], unit)
    matched: NDArray[np.int64] = np.where(mutual & near, row, -1)
    return matched


def _spacing(splats: Splats) -> float:
    """Typical distance between neighbours, metres."""
    if len(splats) < 2:
        return 0.0
    from scipy.spatial import cKDTree

    distance = cKDTree(splats.means).query(splats.means[:: max(1, len(splats) // SPACING_PROBES)], k=2)[0][:, 1]
    return float(np.median(distance))


def _features(splats: Splats, unit: float) -> F32:
    return np.concatenate([splats.means / unit, splats.sh0 * (SH_C0 * COLOUR_WEIGHT)], axis=1)
