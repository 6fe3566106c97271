"""Frames of splats that keep their looks: new splats, changed attributes, and motion.

The looks of a splat are sent when it appears. Later frames send single attributes if the decoder's copy is visibly
wrong, and chunks of motion. A chunk covers one tile of looks for some frames: positions, rotations, fades and ends of
life, all relative to the decoder's copy of the looks, so nothing drifts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cags_common.bundle.manifest import MotionSteps
from cags_common.geometry import F32, F64, Vec3
from cags_common.motion.apply import Steps
from cags_common.splats import Ids, Splats
from cags_common.tiles.morton import morton_order, tile_ranges
from cags_common.tiles.payloads import DELTA_TILE_SPLATS, KEY_TILE_SPLATS
from cags_common.tiles.ramps import AT_ONCE, Ramps
from cags_common.tiles.svq import CodebookSet
from cags_common.tiles.updates import RAMP_COLUMNS
from cags_encoder.codecs.svq import SvqCodec, SvqSplats
from cags_encoder.frames.differential import QuantisedDelta
from cags_encoder.frames.outdated import Outdated
from cags_encoder.motion.chunks import ROUND, TrackSpan
from cags_encoder.motion.fades import changing, fit_fades
from cags_encoder.motion.tolerance import Tolerances
from cags_encoder.motion.trails import Trails, Window
from cags_encoder.settings import EncodeSettings
from cags_encoder.tiling import CutTile, corners, cut_tiles
from cags_encoder.tracks.effect import drawn, of_axes
from cags_encoder.tracks.lasting import EFFECTS, RAMPS, Coming, Held, segment, weights_of
from cags_encoder.tracks.placing import Bound, Placed, Told
from cags_encoder.tracks.rows import SplatTable

PHASES = 4
"""Number of different lengths of a key frame's first chunks, so that later chunks begin at different frames."""


SHARE = 0.25
"""Share of the change threshold allowed for one attribute: its error lasts, and other attributes have errors too."""

COLUMNS = {"scale": "log_scales", "sh0": "sh0", "sh_rest": "sh_rest"}
"""Attributes that can be sent alone, and their columns of :class:`Splats`."""

MOVED = 0.05
"""Motion, in standard deviations, from which on a new splat counts as moving."""

MOST_CHANGE = 0.5
"""If more than this share of the splats changes, updates are cut into tiles by id, which then takes no bytes: the ids
of a key frame ascend along the curve that tiles follow.
"""

STILL = 2.0
"""Splats need no chunk if they stay within this many tolerances of the position held, and within one finest unit."""


@dataclass(frozen=True, eq=False)
class UpdateCut:
    """One tile of changed attributes, before packing."""

    ids: Ids  # [n] ascending
    changed: Mapping[str, NDArray[np.bool_]]  # attribute -> [n]
    frames: Mapping[str, NDArray[np.uint8]]  # column -> [n] in how many frames values are reached; at once without it
    coded: SvqSplats  # [n]
    bounds: tuple[Vec3, Vec3]


@dataclass(frozen=True, eq=False)
class _Again:
    """Splats [k] that are there and of which something may have to be sent again."""

    ids: Ids
    true: Splats  # of the source
    told: Splats  # what is coded in their place
    lengths: dict[str, NDArray[np.uint8]]  # column -> in how many frames values are reached
    prepared: Splats
    coded: SvqSplats
    fresh: Splats  # as decoded
    changed: dict[str, NDArray[np.bool_]]  # attribute -> whether it is sent again
    whole: NDArray[np.bool_]  # whether all looks are


@dataclass(eq=False)
class _Track:
    """A tile of looks that still has live splats."""

    key: tuple[int, int]
    ids: Ids  # [n]
    anchors: F32  # [n, 3] decoded positions
    coarse: F32  # [n, 3] those of level 0
    means: F32  # [n, 3] of the source, when the looks were sent
    quats: F32  # [n, 4] of the source, when the looks were sent
    steps: Steps
    round: NDArray[np.bool_]
    next: int
    """Frame at which the next chunk may begin."""
    first_span: int
    end: Window | None = None
    """How the last chunk leaves the splats (one frame); None before any chunk."""
    refined: bool = False
    """Whether the looks' positions are coarse, and the first chunk codes where its span begins."""
    fades: bool = False
    """Whether the last chunk contains fades. If held at its end, its splats would stay faded."""


class MovingGroups:
    """Chooses the content of each frame, group after group."""

    def __init__(
        self,
        codec: SvqCodec,
        steps: MotionSteps,
        trails: Trails,
        settings: EncodeSettings,
        tolerances: Tolerances,
        *,
        outdated: Outdated | None = None,
    ) -> None:
        """``outdated`` looks at what updates replace."""
        self._codec, self._trails, self._tolerances, self._outdated = codec, trails, tolerances, outdated
        self._span, self._threshold = settings.motion_span, settings.change_threshold
        self._steps = Steps(np.array(steps.moves, np.float32), np.array(steps.turns, np.float32))
        self._books: CodebookSet = codec.quantiser.books
        self._tolerated = tolerances  # of the current group
        self._tracks: list[_Track] = []
        self._held: SplatTable | None = None
        self._ramps: dict[str, Ramps] = {}
        self._noise: dict[str, F64] = {column: np.zeros(0) for column in RAMP_COLUMNS}
        """Column -> visible effect [capacity] of quantisation alone of the value that was sent last."""
        self._axes = np.zeros((0, 3), np.int64)  # [capacity] order of a splat's axes in its looks
        self._fading = np.zeros(0, bool)  # [capacity] whether a fade describes the opacity now
        self._faded: list[Ids] = []  # ids whose fades ended at this frame
        self._owner = np.zeros((0, 2), np.int64)  # [capacity] key of the tile that holds a splat's looks

    def send(self, frame: Placed, quantised: QuantisedDelta) -> tuple[CutTile | UpdateCut | TrackSpan, ...]:
        """Content of ``frame``; ``quantised`` [b] are its new splats."""
        if frame.key:
            self._tracks, self._held = [], None
            self._tolerated = self._tolerances
            if self._outdated is not None:
                self._outdated.restart()
        self._room(frame.capacity)
        self._advance(frame.index)
        assert frame.told is not None
        born, new = frame.delta.ids[frame.births], frame.told.splats
        again = self._again(frame, frame.told)
        if again is None:
            looks = self._looks(frame, born, _svq(quantised), quantised.prepared.means, new)
        else:
            whole, coded = np.flatnonzero(again.whole), _svq(quantised).joined(again.coded.take(again.whole))
            means = np.concatenate([quantised.prepared.means, again.prepared.means[whole]])
            all_ids, told = np.concatenate([born, again.ids[whole]]), Splats.concatenate([new, again.told.take(whole)])
            looks = self._looks(frame, all_ids, coded, means, told)
        if frame.key:
            self._tolerated = self._tolerances.over(self._moving_share(frame.index))
        self._mark_gone(frame.delta.removed)
        self._faded = []
        chunks = self._chunks(frame.index)
        updates = [] if again is None else self._updates(frame.index, again)
        judged = np.zeros(0, np.int32) if again is None else again.ids
        updates += self._after_fades(frame.index, judged)
        if self._outdated is not None and self._held is not None:
            self._outdated.look(frame.index, self._held)
        return (*looks, *chunks, *updates)

    def _room(self, capacity: int) -> None:
        more = capacity - len(self._fading)
        if more > 0:
            self._axes = np.concatenate([self._axes, np.tile(np.arange(3), (more, 1))])
            self._fading = np.concatenate([self._fading, np.zeros(more, bool)])
            self._owner = np.concatenate([self._owner, np.full((more, 2), -1)])
            self._noise = {c: np.concatenate([known, np.zeros(more)]) for c, known in self._noise.items()}

    def _mark_gone(self, removed: Ids) -> None:
        if self._held is not None:
            self._held.alive[removed] = False

    # --------------------------------------------------------------------------------------------------------- looks

    def _looks(self, frame: Placed, ids: Ids, coded: SvqSplats, means: F32, told: Splats) -> list[CutTile]:
        """Tiles of splats ``ids`` [n] that are new or sent whole again, at ``means`` [n, 3]; ``told`` [n] are what was
        ``coded``.
        """
        if not len(ids):
            return []
        order = np.argsort(ids, kind="stable")
        ids, coded, means, told = ids[order], coded.take(order), means[order], told.take(order)
        largest = KEY_TILE_SPLATS if frame.key else DELTA_TILE_SPLATS
        tiles = cut_tiles(ids, means, coded, largest=largest, id_range=frame.key)
        out = []
        for number, cut in enumerate(tiles):
            tile = cut if frame.key else self._coarsened(cut, frame.index)
            out.append(tile)
            assert isinstance(tile.coded, SvqSplats)
            shown = self._codec.shown(tile.coded)
            self._hold(tile.ids, shown)
            mine = told.take(np.searchsorted(ids, tile.ids))
            if self._codec.quantiser.canonical_axes:
                self._axes[tile.ids] = np.argsort(-mine.log_scales, axis=1, kind="stable")
            self._fading[tile.ids], self._owner[tile.ids] = False, (frame.index, number)
            scales = np.take_along_axis(mine.log_scales, self._axes[tile.ids], axis=1)
            for name, effect in _effects(shown, mine, scales, drawn(mine.logit_opacities)).items():
                self._noise[COLUMNS[name]][tile.ids] = effect
            self._tracks.append(self._track((frame.index, number), tile, shown, mine))
            if frame.key:
                self._tracks[-1].first_span = -(-self._span * (1 + number % PHASES) // PHASES)
        return out

    def _coarsened(self, tile: CutTile, frame: int) -> CutTile:
        """``tile`` with coarser positions if most of its splats end or move: their first chunk codes the rest."""
        last = min(frame + self._span, self._trails.last(frame))
        window = self._trails.window(tile.ids, frame, last)
        away = np.abs(window.means - window.means[0]).max(axis=2)
        assert isinstance(tile.coded, SvqSplats)
        moved = np.where(window.present, away, 0.0).max(axis=0) > MOVED * tile.coded.radii
        if last == frame or (moved | ~window.present[-1]).mean() <= 0.5:
            return tile
        return replace(tile, coded=replace(tile.coded, refined=True))

    def _hold(self, ids: Ids, shown: Splats) -> None:
        if self._held is None:
            self._held = SplatTable(shown.take(slice(0, 0)))
            self._ramps = {column: Ramps(array.shape[1:]) for column, array in shown.arrays() if column in RAMP_COLUMNS}
        self._held.put(ids, shown)
        for ramps in self._ramps.values():
            ramps.drop(ids)

    def _track(self, key: tuple[int, int], tile: CutTile, shown: Splats, source: Splats) -> _Track:
        coded = tile.coded
        assert isinstance(coded, SvqSplats)
        base = self._books["scale"].layer(coded.codes["scale"], 0)
        is_round = np.ptp(source.log_scales, axis=1) < np.log(ROUND)
        steps = Steps(self._steps.moves[base], self._steps.turns[base])
        coarse = self._codec.means_at(coded, 0)
        return _Track(
            *(key, tile.ids, shown.means, coarse, source.means, source.quats, steps, is_round, key[0], self._span),
            refined=coded.refined,
        )

    # ------------------------------------------------------------------------------------------------------- updates

    def _advance(self, frame: int) -> None:
        """Bring the decoder's copy to ``frame``."""
        if self._held is None:
            return
        for column, ramps in self._ramps.items():
            ids, values, _ = ramps.at(float(frame))
            self._held.set(column, ids, values)

    def _again(self, frame: Placed, told: Told) -> _Again | None:
        """The splats that look different and whose copy in the decoder is farther off than it may be; None for none."""
        old = np.flatnonzero(frame.looks & ~frame.births)
        if self._held is None or not len(old):
            return None
        ids, true = frame.delta.ids[old], frame.delta.splats.take(old)
        held, axes = self._held.take(ids), self._axes[ids]
        weight = np.maximum(drawn(held.logit_opacities), drawn(true.logit_opacities))
        wrong = _effects(held, true, np.take_along_axis(true.log_scales, axes, axis=1), weight)
        noise = {name: self._noise[column][ids] for name, column in COLUMNS.items()}
        over = {name: wrong[name] > noise[name] + told.bounds[column].wrong for name, column in COLUMNS.items()}
        dim = np.abs(drawn(held.logit_opacities) - drawn(true.logit_opacities)) > SHARE * self._threshold
        rows = np.flatnonzero(np.logical_or.reduce([*over.values(), dim & ~self._fading[ids]]))
        if not len(rows):
            return None
        bounds = {column: bound.take(rows) for column, bound in told.bounds.items()}
        weight, over = weight[rows], {name: mask[rows] for name, mask in over.items()}
        again = self._segments(ids[rows], true.take(rows), weight, over, bounds, frame=frame.index)
        # Codes list the largest axis first. If their order changed after the looks were sent, updates are wrong.
        now, fresh = again.prepared, again.fresh
        noise = _effects(fresh, now, now.log_scales, weight)
        asked = np.take_along_axis(again.told.log_scales, axes[rows], axis=1)
        swapped = weight * EFFECTS["log_scales"](of_axes(asked) * np.abs(fresh.log_scales - asked))
        other_axes = swapped > noise["scale"] + bounds["log_scales"].wrong
        noise["scale"] = np.where(other_axes, noise["scale"], swapped)
        for name, column in COLUMNS.items():
            again.changed[name] &= wrong[name][rows] > noise[name] + bounds[column].wrong
            self._noise[column][again.ids[again.changed[name]]] = noise[name][again.changed[name]]
        again.whole[:] = again.changed["scale"] & other_axes
        return again

    def _segments(
        self,
        ids: Ids,
        true: Splats,
        weight: F64,
        over: dict[str, NDArray[np.bool_]],
        bounds: Mapping[str, Bound],
        *,
        frame: int,
    ) -> _Again:
        """What to send of ``ids`` [k], which are ``true`` [k] with opacities ``weight`` [k], where attributes are
        ``over`` their ``bounds``.

        A splat of which a ramp would end with another order of axes would have to be sent whole, and be seen at once as
        it is to be at the ramp's end: it gets no ramp.
        """
        assert self._held is not None
        coming, axes, told = Coming(true, ids, self._trails.later(frame)), self._axes[ids], dict(true.arrays())
        held = dict(self._held.take(ids).arrays())
        lengths = {column: np.full(len(ids), AT_ONCE, np.uint8) for column in RAMP_COLUMNS}
        weights, all_at_once = weights_of(true), np.zeros(len(ids), bool)

        def choose(name: str, rows: NDArray[np.intp], ramps: Sequence[int]) -> None:
            column = COLUMNS[name]
            now, frames = getattr(true, column)[rows], coming.frames(column, rows)
            begins = self._ramps[column].ends(ids[rows], held[column][rows])
            on_way = (begins != held[column][rows]).any(axis=tuple(range(1, begins.ndim)))
            if column == "log_scales":  # the decoder's copy lists axes in the order of the looks
                begins = np.take_along_axis(begins, np.argsort(axes[rows], axis=1), axis=1)
            before, seen = Held(begins, self._noise[column][ids[rows]]), (EFFECTS[column], weights[column][rows])
            told[column][rows], lengths[column][rows], pays = segment(
                before, now, frames, seen, bounds[column].take(rows), ramps=ramps
            )
            over[name][rows] = pays | on_way  # a ramp that is not replaced would go on to its own end

        for name, column in COLUMNS.items():  # scales first: they decide whether there are ramps
            rows = np.flatnonzero(over[name] & ~all_at_once)
            told[column] = told[column].copy()
            choose(name, rows, RAMPS)
            if column == "log_scales":
                asked = np.take_along_axis(told[column], axes, axis=1)
                turned = weight * EFFECTS[column](np.abs(asked + np.sort(-asked, axis=1))) > bounds[column].wrong
                all_at_once = turned & (lengths[column] > AT_ONCE) & self._codec.quantiser.canonical_axes
            rows = np.flatnonzero(over[name] & all_at_once)
            choose(name, rows, ())
        splats = Splats(**told)
        prepared = self._codec.prepare(splats)
        coded = self._codec.quantise(prepared)
        nothing = np.zeros(len(ids), bool)
        return _Again(ids, true, splats, lengths, prepared, coded, self._codec.decode(coded), over, nothing)

    def _brighter(self, ids: Ids, true: Splats, fresh: Splats) -> NDArray[np.bool_]:
        """Which splats [k] have a visibly wrong opacity that no fade describes."""
        if self._held is None or not len(ids):
            return np.zeros(len(ids), bool)
        alpha = drawn(true.logit_opacities)
        wrong = np.abs(drawn(self._held.take(ids).logit_opacities) - alpha)
        noise = np.abs(drawn(fresh.logit_opacities) - alpha)
        return (wrong > noise + SHARE * self._threshold) & ~self._fading[ids]

    def _updates(self, frame: int, again: _Again) -> list[UpdateCut]:
        ids = again.ids
        changed = {name: mask & ~again.whole for name, mask in again.changed.items()}
        changed["opacity"] = self._brighter(ids, again.true, again.fresh)
        rows = np.flatnonzero(np.logical_or.reduce(list(changed.values())))
        if not len(rows) or self._held is None:
            return []
        if self._outdated is not None and self._outdated.wants(frame):
            of = {column: changed[name][rows] for name, column in (*COLUMNS.items(), ("opacity", "logit_opacities"))}
            self._outdated.lack(frame, ids[rows], of, self._held.take(ids[rows]))
        self._take_over(frame, ids, changed, again.fresh, again.lengths)
        means = again.prepared.means
        most = len(rows) > MOST_CHANGE * int(self._held.alive.sum())
        order = rows if most else rows[morton_order(means[rows])]
        tiles = []
        for first, end in tile_ranges(len(order), DELTA_TILE_SPLATS):
            run = np.sort(order[first:end])
            masks = {book.attribute: self._mask(book.attribute, changed)[run] for book in self._books}
            lengths = {column: length[run] for column, length in again.lengths.items()}
            tiles.append(UpdateCut(ids[run], masks, lengths, again.coded.take(run), corners(means[run])))
        return tiles

    def _after_fades(self, frame: int, judged: Ids) -> list[UpdateCut]:
        """Opacities of splats whose fade has ended and that are not among the ``judged`` ones: the decoder holds their
        largest opacity.
        """
        ids = np.setdiff1d(np.concatenate([np.zeros(0, np.int32), *self._faded]), judged).astype(np.int32)
        if not len(ids) or self._held is None:
            return []
        window, held = self._trails.window(ids, frame, frame), self._held.take(ids)
        alpha = np.clip(window.opacities[0].astype(np.float64), 1e-9, 1 - 1e-9)
        true = replace(held, logit_opacities=np.log(alpha / (1 - alpha)).astype(np.float32))
        coded = self._codec.quantise(true)
        fresh = self._codec.decode(coded)
        rows = np.flatnonzero(self._brighter(ids, true, fresh) & window.present[0])
        if not len(rows):
            return []
        nothing, only = np.zeros(len(rows), bool), fresh.take(rows)
        changed = {"scale": nothing, "sh0": nothing, "sh_rest": nothing, "opacity": ~nothing}
        self._take_over(frame, ids[rows], changed, only, {})
        masks = {book.attribute: self._mask(book.attribute, changed) for book in self._books}
        return [UpdateCut(ids[rows], masks, {}, coded.take(rows), corners(window.means[0][rows]))]

    @staticmethod
    def _mask(attribute: str, changed: dict[str, NDArray[np.bool_]]) -> NDArray[np.bool_]:
        if attribute.startswith("rotation"):
            return np.zeros(len(changed["scale"]), bool)
        name = {"alpha": "opacity", "sh1": "sh_rest", "sh2": "sh_rest", "sh3": "sh_rest"}.get(attribute, attribute)
        return changed[name]

    def _take_over(
        self,
        frame: int,
        ids: Ids,
        changed: Mapping[str, NDArray[np.bool_]],
        fresh: Splats,
        lengths: Mapping[str, NDArray[np.uint8]],
    ) -> None:
        """The decoder's copy of ``ids`` [k] takes what ``changed`` [k] over from ``fresh`` [k], in so many frames."""
        assert self._held is not None
        new = dict(fresh.arrays())
        dim = changed["opacity"]
        self._held.set("logit_opacities", ids[dim], new["logit_opacities"][dim])
        for name, column in COLUMNS.items():
            mask = changed[name]
            if mask.any():
                mine, ramps = ids[mask].astype(np.intp), self._ramps[column]
                begins = ramps.ends(mine, getattr(self._held.take(ids[mask]), column))
                since = np.full(len(mine), frame - 1, np.int32)
                ramps.put(mine, frame, lengths[column][mask], (begins, new[column][mask]), since)
        self._advance(frame)

    # -------------------------------------------------------------------------------------------------------- motion

    def _chunks(self, frame: int) -> list[TrackSpan]:
        """The chunks that begin at ``frame``."""
        spans: list[TrackSpan] = []
        for track in self._tracks:
            if track.next == frame:
                span = self._span_of(track, frame)
                spans += [span] if span is not None else []
        self._tracks = [track for track in self._tracks if track.next > frame]
        return spans

    def _span_of(self, track: _Track, frame: int) -> TrackSpan | None:
        """The chunk of a tile from ``frame`` on, where it needs one; the track's ``next`` moves on, or ends."""
        later = frame > track.key[0]
        length = min(self._span if later else track.first_span, self._trails.last(frame) - frame)
        window = self._trails.window(track.ids, frame, frame + length)
        mine = (self._owner[track.ids] == track.key).all(axis=1)
        window.present[:, ~mine] = False
        if length < 1 or not window.present[0].any():
            track.next = -1
            return None
        track.next = frame + length
        logits = self._held.take(track.ids).logit_opacities if self._held is not None else np.zeros(0, np.float32)
        fades = self._fades(track, window, drawn(logits))
        if fades is None and not window.ends() and not track.fades and self._is_still(track, window):
            return None
        track.end, track.fades = window.last(), fades is not None
        return TrackSpan(
            *(track.key, window.means, window.quats, window.present, track.anchors, track.coarse, track.quats),
            *(track.steps, track.round, later or track.refined, self._lives(window), fades, self._tolerated),
        )

    def _moving_share(self, frame: int) -> float:
        """Share of a key frame's splats that move within the first span."""
        last, moving, splats = min(frame + self._span, self._trails.last(frame)), 0, 0
        for track in self._tracks:
            window = self._trails.window(track.ids, frame, last)
            away = np.abs(window.means - track.anchors).max(axis=2)
            moving += int((np.where(window.present, away, 0.0).max(axis=0) > 4 * track.steps.moves).sum())
            splats += len(track.ids)
        return moving / max(splats, 1)

    def _is_still(self, track: _Track, window: Window) -> bool:
        """Whether the tile looks right without a chunk for these frames."""
        if track.end is not None:
            means, quats = track.end.means[0], track.end.quats[0]
        else:
            means, quats = track.anchors, track.quats
        alive = window.present[0]
        if track.end is None and not track.refined and _rests(window, track.means, track.quats, alive):
            return True  # positions are as exact as the ladder of levels has them: what is finer was not worth it
        away = np.abs(window.means[:, alive] - means[alive]).max(axis=2, initial=0.0)
        moved, turned_ = (min(STILL * t.top, 1.0) for t in (self._tolerated.moves, self._tolerated.turns))
        if (away > moved * track.steps.moves[alive]).any():
            return False
        closeness = np.abs((window.quats[:, alive].astype(np.float64) * quats[alive]).sum(axis=2))
        turned = np.sqrt(np.maximum(1.0 - np.square(closeness), 0.0))
        return not (turned > turned_ * np.where(track.round, np.inf, track.steps.turns)[alive]).any()

    def _lives(self, window: Window) -> NDArray[np.uint8] | None:
        """Number of frames for which each splat [n] exists; the chunk's length plus one if it lives on."""
        if window.present.all():
            return None
        lives: NDArray[np.uint8] = window.present.sum(axis=0).astype(np.uint8)
        return lives

    def _fades(self, track: _Track, window: Window, held: F64) -> NDArray[np.int64] | None:
        """Fades of the splats [n] relative to the opacities ``held`` [n]; None if no splat fades."""
        opacities = window.opacities.astype(np.float64)
        middles = (window.present.sum(axis=0) - 1) / 2
        fades, fits = fit_fades(opacities, window.present, held, middles)
        # A constant opacity is as exact as the ladder of levels has it; a wide fade would only refine it.
        fades[~(fits & (changing(opacities, window.present) | self._fading[track.ids]))] = 0
        mine = window.present[0]
        self._faded.append(track.ids[mine & self._fading[track.ids] & (fades[:, 0] == 0)])
        self._fading[track.ids[mine]] = fades[mine, 0] > 0
        return fades if fades.any() else None


def _rests(window: Window, means: F32, quats: F32, alive: NDArray[np.bool_]) -> bool:
    """Whether the splats that are ``alive`` [n] keep the positions and rotations [n] that their looks had."""
    return bool(np.all(window.means[:, alive] == means[alive]) and np.all(window.quats[:, alive] == quats[alive]))


def _svq(quantised: QuantisedDelta) -> SvqSplats:
    assert isinstance(quantised.coded, SvqSplats)
    return quantised.coded


def _effects(shown: Splats, true: Splats, scales: F32, weight: F64) -> dict[str, F64]:
    """Visible effect [n] (0..1 of a pixel's colour) of the errors in each attribute of ``shown``.

    ``scales`` are the true log scales in the shown order of axes; ``weight`` [n] are drawn opacities.
    """
    pairs = {
        "scale": (shown.log_scales, scales),
        "sh0": (shown.sh0, true.sh0),
        "sh_rest": (shown.sh_rest, true.sh_rest),
    }
    off = {name: np.abs(a - b) for name, (a, b) in pairs.items()}
    off["scale"] = of_axes(scales) * off["scale"]
    return {name: weight * EFFECTS[COLUMNS[name]](differences) for name, differences in off.items()}
