"""Which tiles bring what is seen: looks, the motion that they follow, and updates, with what each is worth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cags_common.geometry import F32, F64
from cags_common.tiles.kinds import TileKind
from cags_server.scene.ownership import Owners
from cags_server.scene.stays import LONGEST_STAY, Stays
from cags_server.scene.tile_map import Key, Numbers, TileMap

CHUNK_AHEAD = 16
"""Frames before its first that a chunk of motion may be sent: chunks that begin together need not travel together, and
an idle link carries what is worth nothing yet.
"""


@dataclass(frozen=True, slots=True)
class VisibleTile:
    """A tile and how many of its splats are seen from a pose."""

    frame: int
    tile: int
    count: int
    weight: float
    """Pixels of the reference that its splats make up."""
    frames_left: float
    """Frames until the media replaces what it brings, about; of motion that begins later, from then on."""
    kind: TileKind = TileKind.LOOKS
    looks: Key | None = None
    """Media frame and tile of the looks that a tile of motion moves."""


@dataclass(frozen=True, eq=False)
class Moment:
    """A frame, and what the bundle says of it."""

    frame: int
    tiles: TileMap
    owners: Owners
    stays: Stays


@dataclass(frozen=True, eq=False)
class Tally:
    """Tiles, and the splats of each that count."""

    numbers: Numbers
    """[m] ascending."""
    counts: NDArray[np.intp]
    """[m] splats."""
    weights: F64
    """[m] sum over the splats, pixels."""
    left: F64
    """[m] mean over the splats, frames."""

    def rows(self, chosen: NDArray[np.intp]) -> Tally:
        """Those of the tiles."""
        return Tally(self.numbers[chosen], self.counts[chosen], self.weights[chosen], self.left[chosen])


def all_looks(moment: Moment) -> Tally:
    """Every tile of looks with splats, each of the weight 1."""
    looks = moment.owners.looks
    every = np.bincount(looks + 1)[1:]  # none first
    there = np.flatnonzero(every)
    counts: NDArray[np.intp] = every[there]
    left = _means(looks + 1, moment.stays.looks, there + 1, counts)
    return Tally(there.astype(np.int32), counts, counts.astype(np.float64), left)


def tiles_of(moment: Moment, splats: NDArray[np.intp], weights: F32) -> tuple[VisibleTile, ...]:
    """Tiles that bring something of ``splats`` [n], ascending, of ``weights`` [n]; those of most splats first."""
    owners, stays = moment.owners, moment.stays
    held = owners.looks[splats] >= 0
    splats, weights = splats[held], weights[held]
    seen = _tallied(owners.looks[splats], weights, stays.looks[splats])
    out = _visible(moment.tiles, seen, TileKind.LOOKS) + _motion(moment.tiles, seen, moment.frame, stays.end)
    return _ordered(out + _updates(moment, splats, weights))


def tiles_of_looks(moment: Moment, seen: Tally) -> tuple[VisibleTile, ...]:
    """Tiles that bring something of tiles of looks, all of whose splats are ``seen``; as :func:`tiles_of`."""
    out = _visible(moment.tiles, seen, TileKind.LOOKS) + _motion(moment.tiles, seen, moment.frame, moment.stays.end)
    updates, looks = moment.owners.updates, moment.owners.looks
    if updates is None or not len(seen.numbers):
        return _ordered(out)
    of_one = np.zeros(int(looks.max()) + 1, np.float32)  # the weight of a splat, by its tile of looks
    of_one[seen.numbers] = seen.weights / seen.counts
    splats = np.flatnonzero((looks >= 0) & (updates >= 0).any(axis=0))
    weights = of_one[looks[splats]]
    return _ordered(out + _updates(moment, splats[weights > 0], weights[weights > 0]))


def _ordered(tiles: list[VisibleTile]) -> tuple[VisibleTile, ...]:
    return tuple(sorted(tiles, key=lambda t: (-t.count, t.frame, t.tile)))


def _tallied(numbers: Numbers, weights: F32, left: NDArray[np.uint8]) -> Tally:
    every = np.bincount(numbers)
    there = np.flatnonzero(every)
    counts: NDArray[np.intp] = every[there]
    made_up: F64 = np.bincount(numbers, weights=weights)[there].astype(np.float64)
    return Tally(there.astype(np.int32), counts, made_up, _means(numbers, left, there, counts))


def _means(numbers: Numbers, left: NDArray[np.uint8], there: NDArray[np.intp], counts: NDArray[np.intp]) -> F64:
    """The mean of ``left`` [n] over the ``counts`` [m] splats of each of the tiles ``there`` [m]."""
    if len(left) and left.min() == left.max():  # as where nothing changes for long: many splats are quick then
        return np.full(len(there), left[0], np.float64)
    means: F64 = np.bincount(numbers, weights=left)[there] / counts
    return means


def _visible(tiles: TileMap, seen: Tally, kind: TileKind, looks: Numbers | None = None) -> list[VisibleTile]:
    columns = (seen.numbers.tolist(), seen.counts.tolist(), seen.weights.tolist(), seen.left.tolist())
    of = [None] * len(seen.numbers) if looks is None else [tiles.key(number) for number in looks.tolist()]
    return [
        VisibleTile(*tiles.key(number), count, weight, left, kind, moved)
        for number, count, weight, left, moved in zip(*columns, of, strict=True)
    ]


def _motion(tiles: TileMap, seen: Tally, frame: int, end: int) -> list[VisibleTile]:
    """The chunks that tiles of looks follow at ``frame``, and those that they follow next."""
    now, following = tiles.chunk_at(seen.numbers, frame), tiles.chunk_after(seen.numbers, frame)
    changes = np.where(following >= 0, tiles.frames[following], end + 1)
    current = _chunks(tiles, seen, now, np.minimum(seen.left, changes - frame))
    ahead: Numbers = changes - frame
    after = tiles.chunk_after(seen.numbers, changes)
    changes_again = np.where(after >= 0, tiles.frames[after], end + 1)
    left = np.minimum(seen.left - ahead, changes_again - changes)
    return current + _chunks(tiles, seen, np.where(ahead <= CHUNK_AHEAD, following, -1), left)


def _chunks(tiles: TileMap, seen: Tally, chunks: Numbers, left: F64) -> list[VisibleTile]:
    chosen = np.flatnonzero((chunks >= 0) & (left > 0))
    of = seen.rows(chosen)
    moved = Tally(chunks[chosen], of.counts, of.weights, np.minimum(left[chosen], LONGEST_STAY))
    return _visible(tiles, moved, TileKind.MOTION, of.numbers)


def _updates(moment: Moment, splats: NDArray[np.intp], weights: F32) -> list[VisibleTile]:
    """Updates in force of ``splats`` [n], of ``weights`` [n]; a splat counts once in each tile."""
    owners, stays = moment.owners, moment.stays
    if owners.updates is None or owners.counts is None or stays.updates is None:
        return []
    rows, found = np.nonzero(owners.counts[:, splats])
    changed = splats[found]
    numbers, left = owners.updates[rows, changed], stays.updates[rows, changed]
    return _visible(moment.tiles, _tallied(numbers, weights[found], left), TileKind.UPDATE)
