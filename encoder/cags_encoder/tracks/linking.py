"""Which splat of a frame continues which of the frame before: mutual nearest neighbours in position and looks.

The velocity of a splat's track (or of its neighbours, for a new track) predicts its position. The nearest splats there
are candidates. The score of a candidate adds the distance, in units of the local spacing, and the differences of scale,
rotation, colour and harmonics, in typical quantisation steps of sources. Each term has a limit, so one attribute may
change by any amount. Opacity does not count, because splats fade.

All measures are relative to the splats, so the unit of length and the number of splats do not matter.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from cags_common.geometry import F32, F64
from cags_common.splats import SH_C0, Splats
from cags_common.tiles.morton import morton_order
from cags_encoder.tracks.flow import FLOW_NEIGHBOURS, TINY, Flow, Rows, field_at, middle_at, velocities_at
from cags_encoder.tracks.rows import identical_rows

USUAL, STRANGE = 90, 3.0
"""Percentile of the differences in looks of a pair of frames, and the multiple of it above which a link is strange."""

STRANGE_LOOKS, STRANGE_PLACE = 2.0, 0.25
"""Difference in looks, and squared distance in units of the spacing, up to which no link is strange."""

FEW, CANDIDATES = 3, 6
"""Number of candidates: among all splats, and among the unlinked ones."""

REACH = 3.0
"""Largest distance from the predicted position, in radii of the splat or in distances to its neighbours."""

ACCEPTED = 12.0
"""Largest score of a link: about the limit of one attribute and a clear difference in another."""

SURE = 1.0
"""Score up to which a link by row is accepted without a search."""

SCALE_STEP, COLOUR_STEP, HARMONICS_STEP, TURN_STEP = 0.15, 0.06, 0.08, 0.15
"""Differences with a score of one: logarithms of scales, RGB, harmonics, and rotation of a long splat in radians."""

LIMIT, HARMONICS_LIMIT = 9.0, 4.0
"""Largest score of one attribute."""

HARMONICS_PARTS = 4
"""Number of fixed random projections of the harmonics that are compared."""

ROUNDS = 3
"""Rounds of mutual matching; each links the mutually nearest and removes them."""

SAMPLE = 1024
"""Sample size, for example for the test whether rows are identities."""

ROWS_HOLD = 0.9
"""Share of the sampled rows whose own row must be the best candidate."""

SEED_LOOKS, SEED_SPREAD = 0.5, 0.25
"""Looks identify a splat if they differ by this at most, and by this share of the second best difference. Its
displacement may differ from those of other such splats by the second number, as a share of its length.
"""

FLOW_ROUNDS, COMPANIONS, EXPLAINED = 12, 16, 0.05
"""Largest number of rounds in which doubtful links are searched again, number of neighbours that predict the position,
and distance from the prediction, as a share of the spacing, up to which a link is explained.
"""

REGION = 64
"""Number of splats around one whose link is not known that are looked at again with it."""

SPARE, MANY = 8, 8
"""Number of neighbours beside those wanted among which these are looked for, and share of splats (one in so many) from
which on a tree of their own is made for them.
"""

APART, LEAST_APART = 4.0, 0.3
"""Multiple of the usual distance of steps from the median of those around them, and distance in spacings, from which
on a step is doubtful, even if it is as its own track's velocity says.
"""

BENDS = 0.7
"""Velocities are extrapolated if that reduces the distance to the predicted positions by this factor."""


@dataclass(frozen=True, eq=False)
class Looks:
    """What splats [n] are compared by."""

    splats: Splats
    means: F64  # [n, 3]
    radii: F64  # [n] mean standard deviation
    signs: F32  # [n, 6 + HARMONICS_PARTS] scales, colours and harmonics, in steps
    stretch: F32  # [n] how much a turn can be seen

    def __len__(self) -> int:
        return len(self.splats)

    @cached_property
    def order(self) -> Rows:
        """Rows [n] such that neighbours lie together: looking them up in it takes half the time."""
        return morton_order(self.splats.means)

    @cached_property
    def field(self) -> Field:
        """Finds those near a place."""
        return Field(self.means, self.order)

    @cached_property
    def spacing(self) -> float:
        """Typical distance between neighbours."""
        means = self.means[:: max(1, len(self) // SAMPLE)]
        return float(np.median(self.local(self.field.near(means, CANDIDATES)[0])))

    def local(self, distances: F64) -> F64:
        """Distances to neighbours [m, 1] from those to the nearest few [m, k]: splats lie on surfaces.

        Where there are but a few they are no measure of each other: they are taken for as dense as can be.
        """
        last: F64 = distances[:, -1:] * distances.shape[1] ** -0.5
        return last if len(self) > CANDIDATES else 0.0 * last

    @staticmethod
    def of(splats: Splats) -> Looks:
        """The looks of ``splats``."""
        logs = np.clip(splats.log_scales, -60, 60)
        rest = splats.sh_rest.reshape(len(splats), -1)
        parts = (
            logs / np.float32(SCALE_STEP),
            splats.sh0 * np.float32(SH_C0 / COLOUR_STEP),
            np.einsum("nk,kp->np", rest, _weights(rest.shape[1])) if rest.shape[1] else _none(len(splats)),
        )
        radii: F64 = np.exp(logs.astype(np.float64)).mean(axis=1)
        stretch = np.minimum(np.ptp(logs, axis=1), 1.0)
        return Looks(splats, splats.means.astype(np.float64), radii, np.concatenate(parts, axis=1), stretch)


def _none(count: int) -> F32:
    """[count, HARMONICS_PARTS] of splats without harmonics."""
    return np.zeros((count, HARMONICS_PARTS), np.float32)


def _weights(count: int) -> F32:
    """[count, HARMONICS_PARTS]: sums by these differ by about one where harmonics differ by a step each."""
    signs = np.random.default_rng(0).choice([-1.0, 1.0], (count, HARMONICS_PARTS))
    weights: F32 = (signs / (HARMONICS_STEP * max(count, 1) ** 0.5 * HARMONICS_PARTS**0.5)).astype(np.float32)
    return weights


@dataclass(frozen=True, eq=False)
class Tracks:
    """A frame's splats [n], and how they came to it."""

    looks: Looks
    velocities: F64  # [n, 3] a frame
    bends: F64  # [n, 3] by how much the velocity was another in the frame before; 0 where there was none
    turning: NDArray[np.bool_]  # [n] whether velocities of splats around here have changed as they did before
    ages: NDArray[np.int64]  # [n] frames before this one that the track has lived through

    @staticmethod
    def begun(looks: Looks) -> Tracks:
        """Tracks of a first frame."""
        still = np.zeros((len(looks), 3))
        return Tracks(looks, still, still, np.zeros(len(looks), bool), np.zeros(len(looks), np.int64))

    def continued(self, after: Looks, rows: Rows) -> Tracks:
        """Tracks of the next frame, whose splats continue ``rows`` [m]; -1: a new track."""
        found = rows >= 0
        step, bends = np.zeros((len(after), 3)), np.zeros((len(after), 3))
        ages = np.zeros(len(after), np.int64)
        came = rows[found]
        step[found] = after.means[found] - self.looks.means[came]
        ages[found] = self.ages[came] + 1
        old = ages > 1
        bends[old] = step[old] - self.velocities[rows[old]]
        return Tracks(after, step, bends, self._turning(after, bends, rows, ages), ages)

    def _turning(self, after: Looks, bends: F64, rows: Rows, ages: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Where the ``bends`` of the next frame [m, 3] were told better by those of this one than by none: among
        :data:`COMPANIONS` splats that lie together, by the medians.
        """
        out = np.zeros(len(after), bool)
        order = after.order
        order = order[ages[order] > 2]
        order = order[np.any(bends[order] != 0, axis=1)]
        groups = len(order) // COMPANIONS
        if not groups:
            return out
        together = order[: groups * COMPANIONS].reshape(groups, COMPANIONS)
        even = np.linalg.norm(bends[together], axis=2)
        bent = np.linalg.norm(bends[together] - self.bends[rows[together]], axis=2)
        turning = np.median(bent, axis=1) < BENDS * np.median(even, axis=1)
        out[together[turning]] = True
        out[order[groups * COMPANIONS :]] = turning[-1]
        return out

    @cached_property
    def next_steps(self) -> F64:
        """By how much each splat is to move next [n, 3]: velocities change again as they did, where that held."""
        steps: F64 = self.velocities + self.bends * self.turning[:, None]
        return steps

    def predicted(self) -> F64:
        """Where each splat is to be looked for in the next frame [n, 3]."""
        moving = self.ages > 0
        velocities = self.velocities.copy()
        if moving.any() and not moving.all():
            velocities[~moving] = velocities_at(self.looks.means[~moving], self.looks.means[moving], velocities[moving])
        expected: F64 = self.looks.means + velocities
        return expected


def link(before: Tracks, after: Looks, known: Rows | None = None) -> Rows:
    """The row of ``before`` that each splat of ``after`` [n] continues, or -1; no row is given twice. Links that are
    ``known`` [n] need not be searched; -1: unknown.
    """
    return _Linking(before, after).run(known)


def differences(before: Looks, after: Looks, rows: Rows, others: Rows) -> F64:
    """How differently ``rows`` [m] of one frame and ``others`` [m] of the next look; 1 is a usual step of sources."""
    looks: F64 = _Pair(before, after).differences(rows, others[:, None], before.means, 1.0)[1][:, 0]
    return looks


def alike(before: Splats, after: Splats, rows: Rows) -> float:
    """Share of the splats of ``after`` [n] that may well continue their ``rows`` of ``before``: they lie within reach
    of them, or look the same. 1 where none has a row.
    """
    linked = np.flatnonzero(rows >= 0)
    linked = linked[:: max(1, len(linked) // SAMPLE)]
    if not len(linked):
        return 1.0
    mine, theirs = Looks.of(before.take(rows[linked])), Looks.of(after.take(linked))
    same = np.arange(len(linked))
    place, looks = _Pair(mine, theirs).differences(same, same[:, None], mine.means, REACH * mine.radii[:, None])
    return float(np.mean((place <= 1.0) | (looks <= ACCEPTED / 2)))


@dataclass(frozen=True, eq=False)
class _Pair:
    """Two frames whose splats are compared."""

    before: Looks
    after: Looks

    def differences(self, rows: Rows, found: Rows, expected: F64, unit: F64 | float) -> tuple[F64, F64]:
        """Differences of place (squared, in ``unit`` [m, 1]) and of looks [m, k] of splats ``found`` [m, k] in the
        frame after from ``rows`` [m] of the frame before, of which all [n] are expected at places [n, 3].
        """
        before, after = self.before, self.after
        apart = after.means[found] - expected[rows][:, None]
        place: F64 = np.einsum("mkc,mkc->mk", apart, apart) / np.square(np.maximum(unit, TINY))
        signs = after.signs[found] - before.signs[rows][:, None]
        parts = (signs[..., :3], signs[..., 3:6], signs[..., 6:])
        scales, colours, harmonics = (np.einsum("mkc,mkc->mk", part, part) for part in parts)
        cosine = np.abs(np.einsum("mkq,mq->mk", after.splats.quats[found], before.splats.quats[rows]))
        turn = 2 * np.arccos(np.minimum(cosine, 1)) * before.stretch[rows][:, None] / TURN_STEP
        looks: F64 = np.minimum(scales, LIMIT) + np.minimum(colours, LIMIT) + np.minimum(turn * turn, LIMIT)
        return place, looks + np.minimum(harmonics, HARMONICS_LIMIT)


class _Linking:
    """One pair of frames. ``rows`` grows step by step."""

    def __init__(self, before: Tracks, after: Looks) -> None:
        self._before, self._after = before.looks, after
        self._pair = _Pair(before.looks, after)
        self._tracks = before
        self.rows: Rows = np.full(len(after), -1, np.intp)
        self._free = np.ones(len(before.looks), bool)
        self._changed = np.ones(len(after), bool)
        self._region = np.ones(len(before.looks), bool)  # where links are looked at again
        self._by_rows = False  # whether rows are identities

    def run(self, known: Rows | None = None) -> Rows:
        """Link what can be linked, beside links that are ``known`` [n]."""
        self._link(*identical_rows(self._before.splats, self._after.splats))
        self._changed = self.rows < 0
        if known is not None:
            new = np.flatnonzero((known >= 0) & self._changed)
            new = new[self._free[known[new]]]
            self._link(known[new], new)
            self._region = self._around(np.flatnonzero(self._free))
        if not self._open():
            return self.rows
        expected = self._expected()
        by_row = self._by_row(expected)
        if self._open():
            self._search(expected, FEW)
        if self._open():
            self._search_by_flow()
        if self._open() and self._search_by_looks():
            self._search_by_flow()
        if not self._by_rows:
            self._settle(expected)
        rows = by_row[self._free[by_row] & (self.rows[by_row] < 0)]
        self._link(rows, rows)
        self._part_strangers(expected)
        return self.rows

    def _expected(self) -> F64:
        """Where the splats of the frame before are looked for [n, 3]: their velocities change as they did before,
        where that was so in the frame before, or where a sample shows that this is nearer than velocities that stay.
        """
        even, bends = self._tracks.predicted(), self._tracks.bends
        turning = even + bends * self._tracks.turning[:, None]
        sample = np.flatnonzero(self._tracks.ages > 1)
        sample = sample[:: max(1, len(sample) // SAMPLE)]
        if len(sample) <= CANDIDATES or not bends.any():
            return even
        away = [np.median(self._after.field.near(e[sample], 1)[0]) for e in (even, even + bends)]
        return even + bends if away[1] < BENDS * away[0] else turning

    def _part_strangers(self, expected: F64) -> None:
        """Undo links of splats whose looks changed more than is usual for this pair of frames, and that are neither at
        the expected place nor where their neighbours went: one ended, and another began beside it. The neighbours are
        first those whose looks changed as usual, then all: a thing that turns changes all its splats, but these move
        together.
        """
        linked = np.flatnonzero((self.rows >= 0) & self._changed)
        came = self.rows[linked]
        place, looks = self._apart(came, linked, expected)
        usual = float(np.percentile(looks, USUAL)) if len(looks) else 0.0
        other = looks > max(STRANGE * usual, STRANGE_LOOKS)
        strange = np.flatnonzero(other & (place > STRANGE_PLACE))
        if len(strange) and not other.all():
            expected = self._moved_with(linked[~other], came[strange])
            place, _ = self._apart(came[strange], linked[strange], expected)
            strange = strange[place > STRANGE_PLACE]
        if len(strange):
            expected = self._moved_by_others(linked, came[strange], field_at, self._before.field)
            place, _ = self._apart(came[strange], linked[strange], expected)
            strange = strange[place > STRANGE_PLACE]
        self._free[came[strange]] = True
        self.rows[linked[strange]] = -1

    def _apart(self, before: Rows, after: Rows, expected: F64) -> tuple[F64, F64]:
        """Differences of place and looks of pairs of rows [p]."""
        place, looks = self._pair.differences(before, after[:, None], expected, self._after.spacing)
        return place[:, 0], looks[:, 0]

    def _open(self) -> bool:
        """Whether there is a splat left in both frames."""
        return bool(self._free.any() and (self.rows < 0).any())

    def _link(self, before: Rows, after: Rows) -> None:
        self.rows[after] = before
        self._free[before] = False

    def _by_row(self, expected: F64) -> Rows:
        """Where rows are identities, link those that surely continue themselves. The other rows that may."""
        count = min(len(self._before), len(self._after))
        rows = np.flatnonzero(self._free[:count] & (self.rows[:count] < 0))
        sample = rows[:: max(1, len(rows) // SAMPLE)]
        if not len(sample) or not self._rows_hold(sample, expected):
            return np.zeros(0, np.intp)
        self._by_rows = True
        scores = self._scores(rows, rows[:, None], expected, self._after.spacing)[:, 0]
        sure = rows[scores <= SURE]
        self._link(sure, sure)
        return rows[(scores > SURE) & (scores <= ACCEPTED)]

    def _rows_hold(self, sample: Rows, expected: F64) -> bool:
        """Whether hardly any of ``sample`` has a better continuation than the same row."""
        own = self._scores(sample, sample[:, None], expected, self._after.spacing)[:, 0]
        likely = own <= ACCEPTED
        if likely.mean() < ROWS_HOLD / 2:
            return False
        best = self._scores(
            sample, self._after.field.near(expected[sample], CANDIDATES)[1], expected, self._after.spacing
        ).min(axis=1)
        return bool(np.mean(own[likely] <= best[likely] + 1e-3) >= ROWS_HOLD)

    def _search(self, expected: F64, candidates: int = CANDIDATES, *, among: NDArray[np.bool_] | None = None) -> None:
        """Link those that are each other's best continuation, and then those of the rest; with ``among`` [n] only such
        of the frame before.
        """
        before, after = self._before.order, self._after.order
        free = self._free if among is None else self._free & among
        before, after = before[free[before]], after[self.rows[after] < 0]
        if not len(before) or not len(after):
            return
        field = self._after.field if len(after) == len(self._after) else Field(self._after.means, after)
        distances, found = field.near(expected[before], candidates)
        if field is not self._after.field:
            distances = self._after.field.near(expected[before], FEW)[0]
        scores = self._scores(before, found, expected, self._after.local(distances))
        for _ in range(ROUNDS):
            mine, theirs = _mutual(scores, found, len(self._after))
            if not len(mine):
                break
            self._link(before[mine], theirs)
            scores[mine] = np.inf
            scores[self.rows[found] >= 0] = np.inf

    def _scores(self, rows: Rows, found: Rows, expected: F64, spacing: F64 | float) -> F64:
        """How unlike ``rows`` [m] the splats ``found`` [m, k] of the frame after are; inf for those out of reach."""
        place, looks = self._pair.differences(rows, found, expected, spacing)
        unit = np.maximum(spacing, TINY)
        reach = REACH * np.maximum(self._before.radii[rows][:, None] / unit, 1.0)
        score = np.minimum(place, LIMIT) + looks
        return np.where((place <= reach * reach) & (score <= ACCEPTED), score, np.inf)

    def _search_by_flow(self) -> None:
        """Look for the rest where their neighbours went."""
        linked = np.flatnonzero(self.rows >= 0)
        if len(linked):
            self._search(self._moved_with(linked, np.flatnonzero(self._free)))

    def _search_by_looks(self) -> bool:
        """Look for the rest where those of them went that are told by their looks alone, and as others around them:
        things that leap. Returns whether there are such.
        """
        from scipy.spatial import cKDTree

        before, after = np.flatnonzero(self._free), np.flatnonzero(self.rows < 0)
        seeds = before[:: max(1, len(before) // SAMPLE)]
        if len(after) < 2:
            return False
        apart, found = cKDTree(self._after.signs[after]).query(self._before.signs[seeds], k=2, workers=1)
        alone = (apart[:, 0] <= SEED_LOOKS) & (apart[:, 0] < SEED_LOOKS * apart[:, 1])
        seeds, moved = seeds[alone], self._after.means[after[found[alone, 0]]] - self._before.means[seeds[alone]]
        if len(seeds) <= FLOW_NEIGHBOURS:
            return False
        usual = velocities_at(self._before.means[seeds], self._before.means[seeds], moved, others=True)
        tolerance = np.maximum(SEED_SPREAD * np.linalg.norm(usual, axis=1), REACH * self._after.spacing)
        agree = np.linalg.norm(moved - usual, axis=1) <= tolerance
        if agree.sum() <= FLOW_NEIGHBOURS:
            return False
        expected = self._before.means.copy()
        expected[before] += velocities_at(expected[before], expected[seeds[agree]], moved[agree])
        self._search(expected)
        return True

    def _settle(self, expected: F64) -> None:
        """Look again for splats that neither their own way nor that of their neighbours explains: what moves by as much
        as its splats lie apart is first linked with the wrong ones, at the edge of what is linked rightly. Neighbours
        say by the median where a splat went, and then, as long as that explains more, by a linear field.
        """
        linked = np.flatnonzero((self.rows >= 0) & self._changed)
        apart = self._apart_from_neighbours(linked)
        came = self.rows[linked[apart | (self._off(linked, expected) > EXPLAINED)]]
        came = came[self._region[came]]
        if len(came) <= FLOW_NEIGHBOURS:
            return
        suspect = np.zeros(len(self._before), bool)
        suspect[self.rows[linked[apart]]] = True
        free = np.flatnonzero(self._free)
        pool, moving = np.union1d(came, free), np.union1d(self.rows[linked], free)
        field = Field(self._before.means, moving)
        around = field.near(self._before.means[pool], COMPANIONS + 1)[1]
        for flow, again in ((middle_at, True), (field_at, False)):
            self._settle_by(flow, expected, _Pool(pool, around, again, suspect), field)

    def _around(self, rows: Rows) -> NDArray[np.bool_]:
        """Mask of the splats of the frame before that lie around some ``rows`` of it."""
        out = np.zeros(len(self._before), bool)
        out[rows] = True
        if len(rows):
            out[self._before.field.near(self._before.means[rows], REGION)[1]] = True
        return out

    def _settle_by(self, flow: Flow, expected: F64, pool: _Pool, moving: Field) -> None:
        """Search for splats of the ``pool`` where ``flow`` says, as long as this explains more of them. After the first
        round only those are looked at whose link, or one near them, has changed.
        """
        best, kept, off = np.inf, self.rows.copy(), np.zeros(len(self._before))
        touched = pool.mask(np.ones(len(off), bool))
        searched = touched if pool.again else np.zeros(len(off), bool)
        for _ in range(FLOW_ROUNDS):
            linked = np.flatnonzero((self.rows >= 0) & self._changed)
            mine = linked[pool.holds(self.rows[linked])]
            own = np.where(pool.suspect[self.rows[mine]], np.inf, self._off(mine, expected))
            off[self.rows[mine[own <= EXPLAINED]]] = 0.0
            stale = mine[(own > EXPLAINED) & touched[self.rows[mine]]]
            off[self.rows[stale]] = self._off(stale, self._moved_by_others(linked, self.rows[stale], flow, moving))
            lost = mine[off[self.rows[mine]] > EXPLAINED]
            left = len(lost) + int(self._free.sum())
            if left >= best:
                break
            best, kept = left, self.rows.copy()
            wanted = self._free & searched
            wanted[self.rows[lost]] = self._free[self.rows[lost]] = True
            self.rows[lost] = -1
            known = np.flatnonzero(self.rows >= 0)
            places = self._moved_by_others(known, np.flatnonzero(wanted), flow, self._before.field)
            self._search(places, among=wanted)
            self._search(expected, among=wanted)
            touched = searched = pool.mask(_linked_otherwise(kept, self.rows, len(off)))
        self.rows = kept
        self._free[:] = True
        self._free[self.rows[self.rows >= 0]] = False

    def _apart_from_neighbours(self, linked: Rows) -> NDArray[np.bool_]:
        """Mask of the links of ``linked`` [m] whose steps are far from the median of those around them, which agree: of
        a patch that is linked one splat off, frame after frame, the edge.
        """
        out = np.zeros(len(linked), bool)
        order = np.argsort(self._place[self.rows[linked]], kind="stable")
        groups = len(order) // COMPANIONS
        if not groups:
            return out
        together = linked[order[: groups * COMPANIONS]].reshape(groups, COMPANIONS)
        steps = self._after.means[together] - self._before.means[self.rows[together]]
        off = np.linalg.norm(steps - np.median(steps, axis=1, keepdims=True), axis=2)
        usual = np.median(off, axis=1, keepdims=True)
        out[order[: groups * COMPANIONS]] = (off > np.maximum(APART * usual, LEAST_APART * self._after.spacing)).ravel()
        return out

    @cached_property
    def _place(self) -> Rows:
        """Where each splat of the frame before stands in the order of neighbours."""
        out = np.empty(len(self._before), np.intp)
        out[self._before.order] = np.arange(len(out))
        return out

    def _off(self, after: Rows, expected: F64) -> F64:
        """How far the splats of ``after`` [m] are from where those that they continue are ``expected`` [n, 3], in
        distances between neighbours.
        """
        off: F64 = np.linalg.norm(self._after.means[after] - expected[self.rows[after]], axis=1)
        return off / max(self._after.spacing, TINY)

    def _moved_by_others(self, linked: Rows, rows: Rows, flow: Flow, among: Field) -> F64:
        """Places of all splats of the frame before [n, 3], ``rows`` of them moved as the :data:`COMPANIONS` nearest
        of the ``linked`` did, themselves aside. The linked are ``among`` the splats of a field.
        """
        came, expected = self.rows[linked], self._before.means.copy()
        if not len(came) or not len(rows):
            return expected
        moved = np.zeros_like(expected)
        moved[came] = self._after.means[linked] - expected[came]
        near = self._nearest(came, rows, min(COMPANIONS + 1, len(came)), among)
        own = near == rows[:, None]
        if near.shape[1] > 1:
            last = np.where(own.any(axis=1)[:, None], near[:, -1:], near[:, -2:-1])
            near = np.where(own, last, near)[:, :-1]
        expected[rows] += flow(expected[rows], expected, moved, near)
        return expected

    def _nearest(self, came: Rows, rows: Rows, count: int, among: Field) -> Rows:
        """The ``count`` nearest [m, count] of ``came`` to each of ``rows`` [m], in the frame before.

        Most of the splats ``among`` which they are have come: of a few more neighbours than wanted, those are taken.
        Only where they are not enough, and for many rows, a tree of those that came is worth making.
        """
        means = self._before.means
        if len(rows) * MANY > len(came):
            return Field(means, came).near(means[rows], count)[1]
        held = np.zeros(len(means), bool)
        held[came] = True
        found = among.near(means[rows], count + SPARE)[1]
        there = held[found]
        near = np.take_along_axis(found, np.argsort(~there, axis=1, kind="stable")[:, :count], axis=1)
        few = np.flatnonzero(there.sum(axis=1) < count)
        if len(few):
            near[few] = Field(means, came).near(means[rows[few]], count)[1]
        return near

    def _moved_with(self, linked: Rows, rows: Rows) -> F64:
        """Places of all splats of the frame before [n, 3], ``rows`` of them moved as the ``linked`` around them."""
        came = self.rows[linked]
        expected = self._before.means.copy()
        moved = self._after.means[linked] - expected[came]
        expected[rows] += velocities_at(expected[rows], self._before.means[came], moved)
        return expected


@dataclass(frozen=True, eq=False)
class _Pool:
    """Splats of the frame before whose links are doubtful, or that have none."""

    rows: Rows  # [m] ascending
    around: Rows  # [m, k] their neighbours
    again: bool
    """Whether those without a link are searched for in the first round, too."""
    suspect: NDArray[np.bool_]
    """[n] whose own way explains nothing."""

    def holds(self, rows: Rows) -> NDArray[np.bool_]:
        """Mask of the ``rows`` that belong to the pool."""
        held: NDArray[np.bool_] = np.isin(rows, self.rows)
        return held

    def mask(self, of: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Mask [n] of the pool's splats that are ``of`` the mask [n], or have neighbours that are."""
        out = np.zeros(len(of), bool)
        out[self.rows] = of[self.rows] | of[self.around].any(axis=1)
        return out


def _linked_otherwise(before: Rows, now: Rows, count: int) -> NDArray[np.bool_]:
    """Mask [count] of the rows that are linked otherwise ``now`` than ``before`` [n]."""
    out = np.zeros(count, bool)
    for rows in (before, now):
        changed = rows[before != now]
        out[changed[changed >= 0]] = True
    return out


class Field:
    """Some rows of a frame's splats, for finding those near a place."""

    def __init__(self, means: F64, rows: Rows) -> None:
        from scipy.spatial import cKDTree

        self._rows = rows
        self._tree = cKDTree(means[rows], balanced_tree=False)  # made in half of the time, and as quick

    def near(self, places: F64, count: int) -> tuple[F64, Rows]:
        """Distances [m, k] and rows [m, k] of the ``count`` splats nearest to each of ``places`` [m, 3]."""
        k = min(count, len(self._rows))
        distances, found = self._tree.query(places, k=k, workers=1)
        return distances.reshape(-1, k), self._rows[found.reshape(-1, k)]


def _mutual(scores: F64, found: Rows, count: int) -> tuple[Rows, Rows]:
    """Rows [p] and the splats [p] of the other frame that are each other's lowest of ``scores`` [m, k]."""
    best = np.argmin(scores, axis=1)
    mine = np.arange(len(scores))
    theirs, lowest = found[mine, best], scores[mine, best]
    rival = np.full(count, np.inf)
    np.minimum.at(rival, found.ravel(), scores.ravel())
    pairs = np.flatnonzero(np.isfinite(lowest) & (lowest <= rival[theirs]))
    first = np.unique(theirs[pairs], return_index=True)[1]  # of equals one
    pairs = pairs[first]
    return pairs, theirs[pairs]
