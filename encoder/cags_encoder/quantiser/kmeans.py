"""k-means by faiss, made safe for what real data holds: few distinct values, duplicates, constants."""

from __future__ import annotations

import faiss
import numpy as np
from numpy.typing import NDArray

from cags_common.geometry import F32

ITERATIONS = 20
"""Lloyd steps; the inertia falls by less than 1 % over the next twenty."""


def kmeans(points: F32, clusters: int, seed: int) -> F32:
    """At most ``clusters`` centres [k, dim] of ``points`` [n, dim], n >= 1; fewer when there are fewer distinct points.

    Deterministic for a seed. Each axis' units count as they are.
    """
    distinct = np.unique(points, axis=0)
    if len(distinct) <= clusters:
        return distinct
    machine = faiss.Kmeans(
        points.shape[1],
        clusters,
        niter=ITERATIONS,
        seed=seed,
        min_points_per_centroid=1,
        max_points_per_centroid=2**30,
    )
    machine.train(np.ascontiguousarray(points, dtype=np.float32))
    centres = np.ascontiguousarray(machine.centroids, dtype=np.float32)
    return centres[np.isfinite(centres).all(axis=1)]


class NearestCentre:
    """Finds the nearest of fixed centres [k, dim]; ties go to the lower index."""

    def __init__(self, centres: F32) -> None:
        self._centres = np.ascontiguousarray(centres, dtype=np.float32)
        if self._centres.shape[1] == 1:
            self._order = np.argsort(self._centres[:, 0], kind="stable")
            rising = self._centres[self._order, 0].astype(np.float64)
            self._edges = (rising[1:] + rising[:-1]) / 2
        else:
            self._index = faiss.IndexFlatL2(self._centres.shape[1])
            self._index.add(self._centres)

    def __call__(self, points: F32) -> NDArray[np.int64]:
        """Indices [n] of the centres nearest to ``points`` [n, dim]."""
        if len(points) == 0:
            return np.zeros(0, np.int64)
        if points.shape[1] == 1:
            return self._order[np.searchsorted(self._edges, points[:, 0].astype(np.float64))]
        _, nearest = self._index.search(np.ascontiguousarray(points, dtype=np.float32), 1)
        found: NDArray[np.int64] = nearest[:, 0]
        return found
