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
class _Seen:
    """Tiles of looks of which something is seen."""

    numbers: Numbers  # [m] ascending
    counts: NDArray[np.intp]
    weights: F64
    left: F64

    def rows(self, chosen: NDArray[np.intp]) -> _Seen:
        return _Seen(self.numbers[chosen], self.counts[chosen], self.weights[chosen], self.left[chosen])


def tiles_of(moment: Moment, contribution: F32, least: float) -> tuple[VisibleTile, ...]:
    """Tiles that bring something of a splat whose ``contribution`` [capacity] exceeds ``least``, most visible first."""
    tiles, owners, stays = moment.tiles, moment.owners, moment.stays
    splats = np.flatnonzero((contribution > least) & (owners.looks >= 0))
    seen = _tallied(owners.looks[splats], contribution[splats], stays.looks[splats])
    out = _visible(tiles, seen, TileKind.LOOKS)
    out += _motion(tiles, seen, moment.frame, stays.end)
    if owners.updates is not None and stays.updates is not None:
        out += _updates(tiles, owners.updates[:, splats], stays.updates[:, splats], contribution[splats])
    return tuple(sorted(out, key=lambda t: (-t.count, t.frame, t.tile)))


def _tallied(numbers: Numbers, weights: F32, left: NDArray[np.uint8]) -> _Seen:
    every = np.bincount(numbers)
    there = np.flatnonzero(every)
    counts: NDArray[np.intp] = every[there]
    made_up: F64 = np.bincount(numbers, weights=weights)[there].astype(np.float64)
    stay: F64 = np.bincount(numbers, weights=left)[there] / counts
    return _Seen(there.astype(np.int32), counts, made_up, stay)


def _visible(tiles: TileMap, seen: _Seen, kind: TileKind, looks: Numbers | None = None) -> list[VisibleTile]:
    columns = (seen.numbers.tolist(), seen.counts.tolist(), seen.weights.tolist(), seen.left.tolist())
    of = [None] * len(seen.numbers) if looks is None else [tiles.key(number) for number in looks.tolist()]
    return [
        VisibleTile(*tiles.key(number), count, weight, left, kind, moved)
        for number, count, weight, left, moved in zip(*columns, of, strict=True)
    ]


def _motion(tiles: TileMap, seen: _Seen, frame: int, end: int) -> list[VisibleTile]:
    """The chunks that tiles of looks follow at ``frame``, and those that they follow next."""
    now, following = tiles.chunk_at(seen.numbers, frame), tiles.chunk_after(seen.numbers, frame)
    changes = np.where(following >= 0, tiles.frames[following], end + 1)
    current = _chunks(tiles, seen, now, np.minimum(seen.left, changes - frame))
    ahead: Numbers = changes - frame
    after = tiles.chunk_after(seen.numbers, changes)
    changes_again = np.where(after >= 0, tiles.frames[after], end + 1)
    left = np.minimum(seen.left - ahead, changes_again - changes)
    return current + _chunks(tiles, seen, np.where(ahead <= CHUNK_AHEAD, following, -1), left)


def _chunks(tiles: TileMap, seen: _Seen, chunks: Numbers, left: F64) -> list[VisibleTile]:
    chosen = np.flatnonzero((chunks >= 0) & (left > 0))
    of = seen.rows(chosen)
    moved = _Seen(chunks[chosen], of.counts, of.weights, np.minimum(left[chosen], LONGEST_STAY))
    return _visible(tiles, moved, TileKind.MOTION, of.numbers)


def _updates(tiles: TileMap, numbers: Numbers, left: NDArray[np.uint8], weights: F32) -> list[VisibleTile]:
    """Updates [attributes, m] in force of the splats that are seen; a splat counts once in each tile."""
    changed = np.flatnonzero((numbers >= 0).any(axis=0))
    numbers, left, weights = numbers[:, changed], left[:, changed], weights[changed]
    counted = numbers >= 0
    for row in range(1, len(numbers)):
        counted[row] &= ~(numbers[:row] == numbers[row]).any(axis=0)
    every = np.broadcast_to(weights, numbers.shape)[counted]
    return _visible(tiles, _tallied(numbers[counted], every, left[counted]), TileKind.UPDATE)
