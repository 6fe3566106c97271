"""Values for attributes that change, chosen to stay within a tolerance for as long as possible.

A decoder keeps a value until an update brings another one, at once or in a ramp over some frames
(:mod:`cags_common.tiles.ramps`). A value that is taken at once is the mean of the coming values: the value of the
current frame is exact now and gets worse with every frame, the mean stays within the same tolerance for twice as long.
Noise of the source, which varies around one value, is then coded once. A drift is followed by ramps: a line stays
within the tolerance for much longer than any value does.

The number of updates is ``speed / tolerance``, and the squared error grows with the square of the tolerance. An error
also matters less the larger the looks' own error is. The total cost is smallest where tolerances grow with the cube
root of speed times the squared error of the looks, times the bytes of an update. Where a value jumps and comes back,
an update is sent if the squared error that it saves, over all frames for which it lasts, is worth its bytes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from cags_common.geometry import F32, F64
from cags_common.splats import SH_C0, Ids, Splats
from cags_common.tiles.morton import morton_order
from cags_common.tiles.ramps import AT_ONCE, LONGEST_RAMP, U8
from cags_encoder.tracks.effect import drawn, of_axes
from cags_encoder.tracks.placing import Bound, Placed
from cags_encoder.tracks.rounding import step_at
from cags_encoder.tracks.rows import bit_keys

Effect = Callable[[NDArray[Any]], NDArray[Any]]
"""Visible effect [n] of absolute differences [n, ...] of one attribute of opaque splats; proportional to them."""

Weighed: TypeAlias = tuple[Effect, F64]
"""The effect of a difference, and weights of differences, of a shape that goes with them (:func:`weights_of`)."""

Seen: TypeAlias = tuple[F32, NDArray[np.bool_]]
"""Values [n, ...] of one attribute in one frame, and which splats [n] are still there."""

RAMPS = (2, 3, 4, 6, 8, 12, LONGEST_RAMP)
"""Lengths of ramps, frames: few, so that they take few bits."""

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

ALONE, RUN = 0.5, 16
"""Weight of a change of scales that a splat's neighbours do not have in common, and how many are compared: what some
splats lose in size others gain. Random errors of scales change pictures a quarter as much as those of colours, but with
such a tolerance for all of its splats *monkey* lost ten decibels.
"""

ALIKE = 0.5
"""Largest price (:func:`_price`) at which splats count as changing together and not each by itself."""

WORTH = 16.0
"""Frames for which an error as large as the tolerance has to last before an update pays: where values of a source jump
for a frame or two and come back, as they do if each frame of it was quantised by itself, they are not followed.
"""

NOISE_STEPS = 1.5
"""Least ratio of the total variation of noise to its largest step; it excludes single jumps."""


def ease_of(psnr_db: float | None) -> float:
    """Factor of the tolerances of what changes fast, for looks of this PSNR with every level; None: not measured."""
    return 1.0 if psnr_db is None else 10 ** ((USUAL_DB - psnr_db) / 30)


def weights_of(splats: Splats) -> dict[str, F64]:
    """Column of ``splats`` [n] -> weights of its differences, of shapes that go with them: their opacities and, of
    scales, what each axis shows.
    """
    opacities = drawn(splats.logit_opacities)
    return {
        "log_scales": opacities[:, None] * of_axes(splats.log_scales),
        "sh0": opacities[:, None],
        "sh_rest": opacities[:, None, None],
    }


@dataclass(frozen=True)
class Allowed:
    """Errors that looks may have."""

    effect: float
    """Visible effect. Without any (0) nothing but the present values will do."""
    ease: float = 1.0
    """What changes by more than twice that may be as much farther off, or, above 1, by less (:func:`ease_of`)."""


def lasting(splats: Splats, ids: Ids, later: Sequence[Placed], allowed: Allowed) -> Splats:
    """``splats`` [n] with ``ids`` [n], and scales, colours and harmonics that last: each is the mean over the longest
    run of this frame and the frames ``later`` in which it stays within its tolerance.
    """
    coming, weights = Coming(splats, ids, later), weights_of(splats)
    told = {}
    for name, effect in EFFECTS.items():
        rows, frames = coming.changing(name)
        now = coming.now[name]
        limit, _ = _bounds(now[rows], frames, coming.places(name, rows), (effect, weights[name][rows]), allowed)
        told[name] = now.copy()
        told[name][rows] = _run(now[rows], frames, (effect, weights[name][rows]), limit)[0]
    return replace(splats, **told)


def bounds(
    splats: Splats, ids: Ids, later: Sequence[Placed], allowed: Allowed, rounded: Mapping[str, F32]
) -> dict[str, Bound]:
    """Column of splats -> how far off it may be in the decoder's copy of ``splats`` [n] with ``ids`` [n], for their
    changes in the frames ``later``. The next value of a codebook to which the source has ``rounded`` a column will do.
    """
    coming, weights = Coming(splats, ids, later), weights_of(splats)
    out = {}
    for name, effect in EFFECTS.items():
        rows, frames = coming.changing(name)
        wrong, alone = np.full(len(splats), allowed.effect), np.ones(len(splats), bool)
        now, places = coming.now[name][rows], coming.places(name, rows)
        seen = effect, weights[name][rows]
        wrong[rows], alone[rows] = _bounds(now, frames, places, seen, allowed)
        if name in rounded and allowed.effect > 0:
            wrong[rows] = np.maximum(wrong[rows], effect(seen[1] * step_at(rounded[name], now)))
        out[name] = Bound(wrong, WORTH * allowed.effect**2 * alone)
    return out


class Coming:
    """Some splats in this frame and the ones after it."""

    def __init__(self, splats: Splats, ids: Ids, later: Sequence[Placed]) -> None:
        """``splats`` [n] with ``ids`` [n] in this frame."""
        self.now = dict(splats.arrays())
        self._changes = _changes(ids, later)

    def changing(self, column: str) -> tuple[NDArray[np.intp], list[Seen]]:
        """Rows [m] of which ``column`` changes, and what it is in each later frame."""
        now = self.now[column]
        differs = np.zeros(len(now), bool)
        for splats, rows, _ in self._changes:
            differs[rows] |= (getattr(splats, column) != now[rows]).any(axis=tuple(range(1, now.ndim)))
        mine = np.flatnonzero(differs)
        return mine, self.frames(column, mine)

    def frames(self, column: str, mine: NDArray[np.intp]) -> list[Seen]:
        """Values [m, ...] of the rows ``mine`` [m] in each later frame, and which of them are still there."""
        place = np.full(len(self.now[column]), -1)
        place[mine] = np.arange(len(mine))
        current, out = self.now[column][mine], []
        for splats, rows, there in self._changes:
            known = place[rows]
            current = current.copy()
            current[known[known >= 0]] = getattr(splats, column)[known >= 0]
            out.append((current, there[mine]))
        return out

    def places(self, column: str, rows: NDArray[np.intp]) -> F32 | None:
        """Where the splats of ``rows`` [m] are [m, 3], if changes of ``column`` count by how far neighbours have them
        in common.
        """
        return self.now["means"][rows] if column == "log_scales" else None


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


def _bounds(
    now: F32, frames: Sequence[Seen], places: F32 | None, seen: Weighed, allowed: Allowed
) -> tuple[F64, NDArray[np.bool_]]:
    """Tolerances [m] of values ``now`` [m, ...] that are those of ``frames`` later, and which of them change by
    themselves: errors that many splats have in common add up.
    """
    effect, weight = seen
    if allowed.effect <= 0 or not frames:
        return np.full(len(now), allowed.effect), np.ones(len(now), bool)
    price = _price(now, frames)
    limit = allowed.effect * _slack(now, frames, effect, weight / allowed.effect, allowed.ease) * np.cbrt(price)
    alone = np.full(len(now), price > ALIKE)
    if places is None:
        return limit, alone
    common = _in_common(weight * (frames[-1][0] - now), places)
    return limit / common, alone & (common < (1 + ALONE) / 2)


def _run(now: F32, frames: Sequence[Seen], seen: Weighed, limit: F64) -> tuple[F32, NDArray[np.intp]]:
    """The value [m, ...] that stays within ``limit`` [m] of the value ``now`` and of those of the frames after it for
    the largest number of frames, and that number [m].
    """
    effect, weight = seen
    low = high = total = now.astype(np.float64)
    count, within = np.ones(len(now), np.intp), limit > 0
    for values, there in frames:
        lower, higher = np.minimum(low, values), np.maximum(high, values)
        within = within & there & (effect(weight * (higher - lower) / 2) <= limit)
        if not within.any():
            break
        taken = _as_wide(within, now)
        low, high, total = (
            np.where(taken, lower, low),
            np.where(taken, higher, high),
            total + np.where(taken, values, 0),
        )
        count += within
    mean = total / _as_wide(count, now)
    fits = (effect(weight * np.maximum(high - mean, mean - low)) <= limit) | (count == 1)
    return np.where(_as_wide(fits, now), mean, (low + high) / 2).astype(np.float32), count


@dataclass(frozen=True, eq=False)
class Held:
    """Values of one attribute in the decoder's copy."""

    values: F32  # [m, ...]
    noise: F64
    """[m] visible effect of their quantisation."""


def segment(
    held: Held, now: F32, frames: Sequence[Seen], seen: Weighed, bound: Bound, *, ramps: Sequence[int] = RAMPS
) -> tuple[F32, U8, NDArray[np.bool_]]:
    """The value [m, ...] to send in place of the one ``held``, and in how many frames [m] it is reached, at once or in
    one of ``ramps``, so that the attribute stays within its ``bound`` [m] of its values ``now`` and in the ``frames``
    after it for longest; and whether [m] that pays. The error of the quantised value that a ramp leaves comes on top,
    and falls to zero with it.

    Slopes of ramps are those of the line through the held value with the least squared error. Longer ramps are tried
    where the next shorter one fits.
    """
    effect, weight = seen
    limit = bound.wrong
    value, lasts = _run(now, frames, seen, limit)
    length = np.full(len(now), AT_ONCE, np.uint8)
    coming = [(now, np.ones(len(now), bool)), *frames]
    fits, start = limit > 0, held.values.astype(np.float64)
    for frame_count in (count for count in ramps if count <= len(coming)):
        rows = np.flatnonzero(fits & coming[frame_count - 1][1])
        if not len(rows):
            break
        here, way = (effect, weight[rows]), [values[rows] - start[rows] for values, _ in coming]
        steps = np.arange(1, frame_count + 1)
        slope = sum(step * gone for step, gone in zip(steps, way[:frame_count], strict=True)) / np.square(steps).sum()
        fitting = np.ones(len(rows), bool)
        for step, gone in zip(steps, way[:frame_count], strict=True):
            farthest = limit[rows] + held.noise[rows] * (1 - step / frame_count)
            fitting &= _within(step * slope - gone, here, farthest)
        reach, stays = np.where(fitting, frame_count, 0), fitting.copy()
        for gone, (_, there) in zip(way[frame_count:], coming[frame_count:], strict=True):
            stays &= there[rows] & _within(frame_count * slope - gone, here, limit[rows])
            reach += stays
        better = reach > lasts[rows]
        chosen = rows[better]
        value[chosen] = (start[rows] + frame_count * slope)[better]
        lasts[chosen], length[chosen] = reach[better], frame_count
        fits[:] = False
        fits[rows[fitting]] = True
    return value, length, _pays(held.values, (value, length, lasts), coming, seen, bound)


def _pays(
    held: F32, sent: tuple[F32, U8, NDArray[np.intp]], coming: Sequence[Seen], seen: Weighed, bound: Bound
) -> NDArray[np.bool_]:
    """Whether to send values ``sent`` [m, ...] in place of those ``held``: always, unless the held value is within its
    bound again in one of the frames ``coming``. Then the squared visible errors saved in the frames for which the sent
    value lasts have to be worth its bytes.
    """
    effect, weight = seen
    value, length, lasts = sent
    saved, again = np.zeros(len(held)), np.zeros(len(held), bool)
    for step, (values, there) in enumerate(coming, start=1):
        shown = held + (value - held) * _as_wide(np.minimum(step / length, 1.0), held)
        old, new = (effect(weight * np.abs(copy - values)) for copy in (held, shown))
        saved += np.where(step <= lasts, np.square(old) - np.square(new), 0.0)
        again |= there & (old <= bound.wrong)
    return ~again | (saved >= bound.worth)


def _within(off: NDArray[Any], seen: Weighed, limit: F64) -> NDArray[np.bool_]:
    effect, weight = seen
    out: NDArray[np.bool_] = effect(weight * np.abs(off)) <= limit
    return out


def _slack(now: F32, frames: Sequence[Seen], effect: Effect, weight: F64, ease: float) -> F64:
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
        size = np.where(there, effect(weight * np.abs(step)), 0.0)
        gone, largest = gone + size, np.maximum(largest, size)
        bent += np.where(there, effect(weight * np.abs(step - change)), 0.0)
        repeated = np.sum((values == before) | (values == earlier), axis=tuple(range(1, now.ndim))) / wide
        again, frames_there = again + np.where(there, repeated, 0.0), frames_there + there
        before, earlier, change = values, before, step
    noise = (bent > gone) & (gone > NOISE_STEPS * largest) & (again > frames_there / 2)
    slack: F64 = np.where(noise, FASTER, np.clip(ease * np.cbrt(gone / 2), 1.0, FASTER))
    return slack


def _price(now: F32, frames: Sequence[Seen]) -> float:
    """Price of updates of values ``now`` [m, ...], relative to splats that all differ: where many are equal and change
    alike, the same codes take few bytes. It is the information in a change, its entropy.
    """
    if len(now) < 2:
        return 1.0
    both = np.concatenate([values.reshape(len(now), -1) for values in (now, frames[-1][0])], axis=1)
    shares = np.unique(bit_keys(both), return_counts=True)[1] / len(now)
    entropy = -float(np.sum(shares * np.log2(shares)))
    return float((1 + entropy) / (1 + np.log2(len(now))))


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
