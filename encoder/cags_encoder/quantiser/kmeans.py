"""k-means by faiss, made robust for real data: few distinct values, duplicates, constants."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import faiss
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from cags_common.geometry import F32

ITERATIONS = 20
"""Lloyd steps; the inertia falls by less than 1 % over the next twenty."""


TREE_DIMS = 4
"""Up to this many dimensions a k-d tree finds nearest centres five times faster than comparing with all of them."""


def kmeans(points: F32, clusters: int, seed: int, iterations: int = ITERATIONS) -> F32:
    """At most ``clusters`` centres [k, dim] of ``points`` [n, dim], n >= 1; fewer if there are fewer distinct points.

    Deterministic for a seed. The axes are not rescaled.
    """
    distinct = np.unique(points, axis=0)
    if len(distinct) <= clusters:
        return distinct
    machine = faiss.Kmeans(
        points.shape[1],
        clusters,
        niter=iterations,
        seed=seed,
        min_points_per_centroid=1,
        max_points_per_centroid=2**30,
    )
    with _one_thread():
        machine.train(np.ascontiguousarray(points, dtype=np.float32))
    centres = np.ascontiguousarray(machine.centroids, dtype=np.float32)
    return centres[np.isfinite(centres).all(axis=1)]


@contextmanager
def _one_thread() -> Iterator[None]:
    """Run faiss on one thread: two are slower on shared cores, and the number of threads does not change the result."""
    before = faiss.omp_get_max_threads()
    faiss.omp_set_num_threads(1)
    try:
        yield
    finally:
        faiss.omp_set_num_threads(before)


class NearestCentre:
    """Finds the nearest of fixed centres [k, dim]. Deterministic."""

    def __init__(self, centres: F32) -> None:
        self._centres = np.ascontiguousarray(centres, dtype=np.float32)
        self._tree = cKDTree(self._centres) if self._centres.shape[1] <= TREE_DIMS else None
        self._index = faiss.IndexFlatL2(self._centres.shape[1])
        self._index.add(self._centres)

    def __call__(self, points: F32) -> NDArray[np.int64]:
        """Indices [n] of the centres nearest to ``points`` [n, dim]."""
        if len(points) == 0:
            return np.zeros(0, np.int64)
        if self._tree is not None:
            return np.asarray(self._tree.query(points)[1], np.int64)
        with _one_thread():
            nearest: NDArray[np.int64] = self._index.search(np.ascontiguousarray(points, dtype=np.float32), 1)[1][:, 0]
        return nearest
