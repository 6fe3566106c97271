"""Merges k-means clusters bottom-up into a few binary trees."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cags_common.geometry import F32, F64
from cags_encoder.quantiser.tree import Fork, Leaf, Node

_I64 = NDArray[np.int64]


def merge_as_printed(points: F32, labels: _I64, centres: F32, target: int) -> list[Node]:
    """Merge until ``target`` clusters remain, by the paper's distance, and return their trees.

    The distance of two clusters is the mean distance of their members from their common mean. Only each cluster's two
    nearest neighbours (by centre) are considered. ``points`` [n, dim] with ``labels`` [n] in 0..k-1 are the members;
    each of ``centres`` [k, dim] must have at least one. Deterministic: ties go to the lower indices.
    """
    return _PrintedMerger(points, labels, centres).run(target)


class _PrintedMerger:
    def __init__(self, points: F32, labels: _I64, centres: F32) -> None:
        k = len(centres)
        order = np.argsort(labels, kind="stable")
        cuts = np.cumsum(np.bincount(labels, minlength=k))[:-1]
        self._members: list[F64] = np.split(points[order].astype(np.float64), cuts)
        self._centres = np.array([member.mean(axis=0) for member in self._members])
        self._nodes: list[Node] = [Leaf(i) for i in range(k)]
        self._alive = np.ones(k, bool)
        self._distance = np.linalg.norm(self._centres[:, None, :] - self._centres[None, :, :], axis=2)
        np.fill_diagonal(self._distance, np.inf)
        self._near = np.zeros((k, 2), np.int64)
        self._cost = np.full((k, 2), np.inf)
        self._refresh(np.arange(k))

    def run(self, target: int) -> list[Node]:
        for _ in range(int(self._alive.sum()) - target):
            row, column = divmod(int(np.argmin(self._cost)), 2)
            self._merge(*sorted((row, int(self._near[row, column]))))
        return [self._nodes[i] for i in np.flatnonzero(self._alive)]

    def _merge(self, keep: int, gone: int) -> None:
        first, second = (keep, gone) if len(self._members[keep]) >= len(self._members[gone]) else (gone, keep)
        middle = self._common_mean(keep, gone)
        self._nodes[keep] = Fork(self._nodes[first], self._nodes[second])
        self._members[keep] = np.concatenate([self._members[keep], self._members[gone]])
        self._members[gone] = np.zeros((0, self._centres.shape[1]))
        self._centres[keep] = middle
        self._alive[gone] = False
        self._distance[gone, :] = self._distance[:, gone] = np.inf
        self._cost[gone] = np.inf
        distances = np.linalg.norm(self._centres - self._centres[keep], axis=1)
        distances[~self._alive] = distances[keep] = np.inf
        self._distance[keep, :] = self._distance[:, keep] = distances
        rows = np.arange(len(self._alive))
        touched = ((self._near == keep) | (self._near == gone)).any(axis=1)
        closer = distances <= self._distance[rows, self._near[:, 1]]
        touched |= closer & np.isfinite(distances)
        touched[keep] = True
        self._refresh(np.flatnonzero(touched & self._alive))

    def _refresh(self, rows: _I64) -> None:
        """Find the two nearest neighbours of ``rows`` again, and the cost of merging with them."""
        self._near[rows] = np.argsort(self._distance[rows], axis=1, kind="stable")[:, :2]
        for row in rows:
            for column, other in enumerate(self._near[row]):
                reachable = np.isfinite(self._distance[row, other])
                self._cost[row, column] = self._dispersion(int(row), int(other)) if reachable else np.inf

    def _common_mean(self, a: int, b: int) -> F64:
        mine, other = len(self._members[a]), len(self._members[b])
        middle: F64 = (self._centres[a] * mine + self._centres[b] * other) / (mine + other)
        return middle

    def _dispersion(self, a: int, b: int) -> float:
        union = np.concatenate([self._members[a], self._members[b]])
        away = union - self._common_mean(a, b)
        return float(np.sqrt(np.einsum("ij,ij->i", away, away)).mean())
