"""Tree-structured vector quantisation: cells are split in two, level by level, all cells of a level at once.

Unlike the paper's bottom-up merging it works top-down. Every prefix of a code is a good quantiser, the tree is
complete, so that each bit carries about one bit of information, and training takes a second instead of minutes (Gersho
and Gray 1992, chapter 12.4).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cags_common.geometry import F64

LLOYD_STEPS = 6
"""Two-means steps per split; more reduce the error by less than 0.5 %."""


def split_tree(points: F64, weights: F64, depth: int) -> tuple[list[F64], NDArray[np.int64]]:
    """Cell means of every level, and each point's cell at the last level.

    ``points`` [n, dim], ``weights`` [n] > 0. Element ``d`` of the list is [2**d, dim]. Children ``2 c`` and ``2 c + 1``
    of cell ``c`` are its lower and upper half along its longest axis. A cell without points repeats its parent's mean.
    """
    cells = np.zeros(len(points), np.int64)
    means = [np.average(points, axis=0, weights=weights)[None]]
    for level in range(depth):
        side = _along_longest_axis(points, weights, cells, means[-1]) > 0
        for _ in range(LLOYD_STEPS):
            halves = cell_means(points, weights, 2 * cells + side, np.repeat(means[-1], 2, axis=0))
            below = np.square(points - halves[2 * cells]).sum(axis=1)
            side = below > np.square(points - halves[2 * cells + 1]).sum(axis=1)
        cells = 2 * cells + side
        means.append(cell_means(points, weights, cells, np.repeat(means[level], 2, axis=0)))
    return means, cells


def halving_tree(points: F64, weights: F64, depth: int) -> tuple[list[F64], NDArray[np.int64]]:
    """Like :func:`split_tree`, but cuts cells at the median: at most 2**depth distinct points end up alone."""
    cells = np.zeros(len(points), np.int64)
    means = [np.average(points, axis=0, weights=weights)[None]]
    for level in range(depth):
        along = _along_longest_axis(points, weights, cells, means[-1])
        order = np.lexsort((along, cells))
        counts = np.bincount(cells, minlength=1 << level)
        starts = np.concatenate([[0], np.cumsum(counts)[:-1]])
        rank = np.empty(len(points), np.int64)
        rank[order] = np.arange(len(points)) - starts[cells[order]]
        cells = 2 * cells + (rank >= (counts[cells] + 1) // 2)
        means.append(cell_means(points, weights, cells, np.repeat(means[level], 2, axis=0)))
    return means, cells


def cell_means(points: F64, weights: F64, cells: NDArray[np.int64], otherwise: F64) -> F64:
    """Weighted mean [k, dim] of each cell's points; the row of ``otherwise`` for cells without points."""
    k = len(otherwise)
    total = np.bincount(cells, weights, k)
    sums = np.stack([np.bincount(cells, weights * column, k) for column in points.T], axis=1)
    return np.where(total[:, None] > 0, sums / np.maximum(total, 1e-300)[:, None], otherwise)


def cell_spreads(points: F64, weights: F64, cells: NDArray[np.int64], means: F64) -> F64:
    """Weighted standard deviation [k, dim] of each cell's points, regularised towards the mean of all cells for cells
    with few points.
    """
    k = len(means)
    away = np.square(points - means[cells])
    total = np.bincount(cells, weights, k)
    sums = np.stack([np.bincount(cells, weights * column, k) for column in away.T], axis=1)
    typical = sums.sum(axis=0) / total.sum()
    prior = PRIOR_POINTS * weights.mean()
    spreads: F64 = np.sqrt((sums + prior * typical) / (total + prior)[:, None])
    return spreads


PRIOR_POINTS = 4.0
"""Weight of the typical spread in each cell's own, in points."""


def _along_longest_axis(points: F64, weights: F64, cells: NDArray[np.int64], means: F64) -> F64:
    """Each point's coordinate [n] relative to its cell's mean along the cell's principal axis, which points to larger
    sums.
    """
    k, dim = means.shape
    away = points - means[cells]
    covariance = np.zeros((k, dim, dim))
    for i in range(dim):
        for j in range(i, dim):
            covariance[:, i, j] = covariance[:, j, i] = np.bincount(cells, weights * away[:, i] * away[:, j], k)
    axis = np.linalg.eigh(covariance)[1][:, :, -1]
    axis = np.where(axis.sum(axis=1, keepdims=True) < 0, -axis, axis)
    along: F64 = np.einsum("ij,ij->i", away, axis[cells])
    return along
