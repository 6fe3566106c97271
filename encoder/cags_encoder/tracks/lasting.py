"""Values for attributes that change, chosen to stay within a tolerance for as long as possible.

A decoder keeps a value until it receives another one. The value of the current frame is exact now and gets worse with
every frame. The mean of the coming values stays within the same tolerance for twice as long, with the same mean error.
Noise of the source, which varies around one value, is then coded once.

The number of updates is ``speed / tolerance``, and the squared error grows with the square of the tolerance. An error
also matters less the larger the looks' own error is. The total cost is smallest where tolerances grow with the cube
root of speed times the squared error of the looks.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cags_common.geometry import F32, F64
from cags_common.splats import SH_C0, Ids, Splats
from cags_common.tiles.morton import morton_order
from cags_encoder.tracks.effect import drawn
from cags_encoder.tracks.placing import Placed, Told

Effect = Callable[[NDArray[Any]], NDArray[Any]]
"""Visible effect [n] of differences [n, ...] of one attribute of opaque splats."""

EFFECTS: dict[str, Effect] = {
    "log_scales": lambda off: off.max(axis=1),
    "sh0": lambda off: SH_C0 * off.max(axis=1),
    "sh_rest": lambda off: SH_C0 * np.sqrt(np.square(off.max(axis=2, initial=0.0)).sum(axis=1)),
}
"""Column of splats -> effect of its absolute differences, share of a pixel's colour; of harmonics in the root mean
square over all directions.
"""


FASTER = 4.0
"""Largest factor by which the tolerance grows with the speed of change, and factor for noise."""

USUAL_DB = 53.0
"""PSNR of looks with every level at which the tolerance depends on the speed alone: that of a room."""

ROUNDED_DB = 58.9
"""PSNR of pixels rounded to 8 bits. More accurate looks do not make an error more visible."""

ALONE, RUN = 0.5, 16
"""Weight of a change of scales that a splat's neighbours do not have in common, and how many are compared: what some
splats lose in size others gain. Random errors of scales change pictures a quarter as much as those of colours, but with
such a tolerance for all of its splats *monkey* lost ten decibels.
"""

NOISE_STEPS = 1.5
"""Least ratio of the total variation of noise to its largest step; it excludes single jumps."""


def ease_of(psnr_db: float | None) -> float:
    """Factor of the tolerances of what changes fast, for looks of this PSNR with every level; None: not measured."""
    return 1.0 if psnr_db is None else 10 ** ((USUAL_DB - min(psnr_db, ROUNDED_DB)) / 30)


def lasting(splats: Splats, ids: Ids, later: Sequence[Placed], most: float, ease: float = 1.0) -> Told:
    """Values to code for ``splats`` [n] with ``ids`` [n]: scales, colours and harmonics.

    Each value is the mean over the longest run of this frame and the frames ``later`` in which it stays within its
    tolerance. The tolerance is a visible effect of ``most``, and more for an attribute that changes by more than twice
    that in those frames, or by less with ``ease`` (:func:`ease_of`) above 1.
    """
    changes = _changes(ids, later)
    weight = drawn(splats.logit_opacities)
    columns = dict(splats.arrays())
    found = {
        name: _lasting(
            columns[name],
            [(dict(now.arrays())[name], rows, there) for now, rows, there in changes],
            effect,
            most,
            weight,
            ease=ease,
            places=splats.means if name == "log_scales" else None,
        )
        for name, effect in EFFECTS.items()
    }
    told = replace(splats, **{name: values for name, (values, _) in found.items()})
    return Told(told, {name: tolerances for name, (_, tolerances) in found.items()})


def _changes(ids: Ids, later: Sequence[Placed]) -> list[tuple[Splats, NDArray[np.intp], NDArray[np.bool_]]]:
    """Of each later frame: looks that differ, rows of ``ids`` that they are of, and which [n] are still there."""
    found, there = [], np.ones(len(ids), bool)
    for frame in later:
        changed = frame.delta.ids[frame.looks]
        there = there & ~np.isin(ids, frame.delta.removed) & ~np.isin(ids, frame.delta.ids[frame.births])
        at = np.minimum(np.searchsorted(changed, ids), max(len(changed) - 1, 0))
        rows = np.flatnonzero(changed[at] == ids) if len(changed) else np.zeros(0, np.intp)
        found.append((frame.delta.splats.take(np.flatnonzero(frame.looks)[at[rows]]), rows, there))
    return found


def _lasting(
    now: F32,
    changes: Sequence[tuple[F32, NDArray[np.intp], NDArray[np.bool_]]],
    effect: Effect,
    most: float,
    weight: F64,
    *,
    ease: float,
    places: F32 | None,
) -> tuple[F32, F64]:
    """:func:`lasting` for one column ``now`` [n, ...], its ``changes`` and the opacities ``weight`` [n]: values, and
    tolerances [n]. Without a tolerance (``most`` of 0) nothing but the present values will do. With ``places`` [n, 3]
    changes count by how far neighbours have them in common.
    """
    if most <= 0:
        return now, np.zeros(len(now))
    differs = np.zeros(len(now), bool)
    for values, rows, _ in changes:
        differs[rows] |= (values != now[rows]).any(axis=tuple(range(1, now.ndim)))
    mine = np.flatnonzero(differs)
    frames, weight = list(_frames(now, changes, mine)), weight[mine]
    tolerance = np.full(len(now), most)
    tolerance[mine] *= _slack(now[mine], frames, effect, weight / most, ease)
    if places is not None and frames:
        tolerance[mine] /= _in_common(frames[-1][0] - now[mine], places[mine])
    limit = tolerance[mine]
    low = high = total = now[mine].astype(np.float64)
    count, within = np.ones(len(mine)), np.ones(len(mine), bool)
    for values, there in frames:
        lower, higher = np.minimum(low, values), np.maximum(high, values)
        within = within & there & (weight * effect((higher - lower) / 2) <= limit)
        taken = _as_wide(within, now)
        low, high, total = (
            np.where(taken, lower, low),
            np.where(taken, higher, high),
            total + np.where(taken, values, 0),
        )
        count += within
    mean = total / _as_wide(count, now)
    fits = weight * effect(np.maximum(high - mean, mean - low)) <= limit
    out = now.copy()
    out[mine] = np.where(_as_wide(fits, now), mean, (low + high) / 2)
    return out, tolerance


def _frames(
    now: F32, changes: Sequence[tuple[F32, NDArray[np.intp], NDArray[np.bool_]]], mine: NDArray[np.intp]
) -> Iterator[tuple[F32, NDArray[np.bool_]]]:
    """Values [m, ...] of the rows ``mine`` [m] in each later frame, and which of them are still there."""
    place = np.full(len(now), -1)
    place[mine] = np.arange(len(mine))
    current = now[mine]
    for values, rows, there in changes:
        known = place[rows]
        current = current.copy()
        current[known[known >= 0]] = values[known >= 0]
        yield current, there[mine]


def _slack(now: F32, frames: Sequence[tuple[F32, NDArray[np.bool_]]], effect: Effect, weight: F64, ease: float) -> F64:
    """Factor [m] of each tolerance for what changes fast, or is noise; ``weight`` [m] are in tolerances.

    Second differences of noise are larger than first differences; those of a trend are smaller. Noise of a quantised
    source returns to one of the two values before in most frames; values that are computed anew in each frame do not.
    A single jump is not noise.
    """
    before, earlier, change = now, np.full_like(now, np.nan), np.zeros_like(now)
    wide = max(math.prod(now.shape[1:]), 1)
    gone, bent, largest, again, frames_there = (np.zeros(len(now)) for _ in range(5))
    for values, there in frames:
        step = values - before
        size = np.where(there, weight * effect(np.abs(step)), 0.0)
        gone, largest = gone + size, np.maximum(largest, size)
        bent += np.where(there, weight * effect(np.abs(step - change)), 0.0)
        repeated = np.sum((values == before) | (values == earlier), axis=tuple(range(1, now.ndim))) / wide
        again, frames_there = again + np.where(there, repeated, 0.0), frames_there + there
        before, earlier, change = values, before, step
    noise = (bent > gone) & (gone > NOISE_STEPS * largest) & (again > frames_there / 2)
    slack: F64 = np.where(noise, FASTER, np.clip(ease * np.cbrt(gone / 2), 1.0, FASTER))
    return slack


def _in_common(change: F32, places: F32) -> F64:
    """Weight [m] of each ``change`` [m, k] at ``places`` [m, 3], world: :data:`ALONE` where neighbours have nothing in
    common, 1 where they all change alike.

    The energy of a sum of ``count`` changes is ``count`` times their mean energy if they are independent, and ``count``
    squared times if they are equal.
    """
    order = morton_order(places)
    first = np.arange(0, len(order), RUN)
    sorted_change = change[order].astype(np.float64)
    count = np.diff(np.append(first, len(order)))
    of_sum = np.square(np.add.reduceat(sorted_change, first, axis=0)).sum(axis=1)
    energy = np.add.reduceat(np.square(sorted_change).sum(axis=1), first)
    common = np.clip((of_sum / np.maximum(energy, 1e-30) - 1) / np.maximum(count - 1, 1), 0.0, 1.0)
    weight: F64 = np.empty(len(order))
    weight[order] = np.repeat(np.sqrt(ALONE**2 * (1 - common) + common), count)
    return weight


def _as_wide(rows: NDArray[Any], like: F32) -> NDArray[Any]:
    """``rows`` [n] in a shape that goes with ``like`` [n, ...]."""
    return rows.reshape(len(rows), *[1] * (like.ndim - 1))
