"""Small bundles with looks, motion and updates, made by hand or at random, and the messages that bring them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from cags_common.bundle import BundleReader, BundleWriter, TilePayloads
from cags_common.bundle.codecs import SvqTileCodec, anchors_of
from cags_common.bundle.manifest import Manifest, MotionSteps
from cags_common.motion.chunk import encode
from cags_common.motion.neighbours import Anchors
from cags_common.store.tile_decode import Arrival
from cags_common.tiles.kinds import TileKind
from cags_common.tiles.payloads import PositionGrid, encode_base, encode_layer
from cags_common.tiles.updates import RAMP_COLUMNS, encode_update
from support.anchors import together
from support.small_store import ATTRIBUTES, CAPACITY, ORDER, books, manifest

BOX = (0.0, 0.0, 0.0), (1.0, 1.0, 1.0)
MOVE_UNIT = 1 / 256


def moving(of: Manifest | None = None) -> Manifest:
    """A manifest with units of motion: large for large splats."""
    units = tuple(MOVE_UNIT * (1 + code) for code in range(4))
    return replace(of or manifest(), motion=MotionSteps(moves=units, turns=units))


def looks(ids: list[int], x: float, rng: np.random.Generator | None = None) -> TilePayloads:
    """Splats at x, of code 1, or elsewhere and of random codes."""
    n = len(ids)
    means = np.full((n, 3), x, np.float32) if rng is None else rng.uniform(0, 60, (n, 3)).astype(np.float32)
    codes = {
        name: np.ones(n, np.uint32) if rng is None else rng.integers(1, 4, n).astype(np.uint32) for name in ATTRIBUTES
    }
    grid = PositionGrid(np.zeros(3, np.float32), 1.0, 16)
    first = encode_base(np.array(ids, np.int32), means, codes, grid, books(), id_range=False)
    bits = [np.ones(n, np.uint32) if rng is None else rng.integers(0, 2, n).astype(np.uint32) for _ in ORDER]
    return TilePayloads(n, None, BOX, (first, *(encode_layer(layer, 1) for layer in bits)))


def motion(of: tuple[int, int], count: int, dx: list[float], lives: list[int] | None = None) -> TilePayloads:
    """``count`` splats that are ``dx`` metres along x from their looks' one place at each frame from the first on."""
    moves = np.zeros((len(dx), count, 3))
    moves[:, :, 0] = np.array(dx)[:, None] / (2 * MOVE_UNIT)  # splats of scale code 1
    ends = None if lives is None else np.array(lives, np.uint8)
    payloads = encode(of, together(count), moves, None, starts=True, lives=ends)
    return TilePayloads(count, None, BOX, payloads, TileKind.MOTION, of, len(dx) - 1)


def update(
    ids: list[int], changed: dict[str, np.ndarray], codes: dict[str, np.ndarray], frames: np.ndarray | None = None
) -> TilePayloads:
    """Single attributes of ``ids``, in so many ``frames``; at once without them."""
    none = np.zeros(len(ids), bool)
    masks = {name: changed.get(name, none) for name in ATTRIBUTES}
    full = {name: codes.get(name, np.zeros(len(ids), np.uint32)).astype(np.uint32) for name in ATTRIBUTES}
    ramps = {} if frames is None else dict.fromkeys(RAMP_COLUMNS, frames.astype(np.uint8))
    payloads = encode_update(np.array(ids, np.int32), masks, full, books(), ORDER, ramps)
    return TilePayloads(len(ids), None, BOX, payloads, TileKind.UPDATE)


def recoloured(ids: list[int], code: int) -> TilePayloads:
    """``ids`` of another base colour: the code [3 bits] of its last level."""
    return update(ids, {"sh0": np.ones(len(ids), bool)}, {"sh0": np.full(len(ids), code)})


@dataclass(frozen=True)
class Clip:
    """A bundle, and the tiles of each of its frames."""

    reader: BundleReader
    frames: list[list[TilePayloads]]

    def arrivals(self) -> Iterator[Arrival]:
        """Every tile at once, with all of its levels."""
        for frame, tiles in enumerate(self.frames):
            for tile, payloads in enumerate(tiles):
                yield Arrival(frame, tile, 0, [memoryview(p) for p in payloads.payloads])

    def messages(self, rng: np.random.Generator) -> list[Arrival]:
        """Every tile cut into runs of levels, some of them twice, in random order."""
        out = []
        for whole in self.arrivals():
            cuts = [0, *np.flatnonzero(rng.random(len(whole.payloads) - 1) < 0.6) + 1, len(whole.payloads)]
            for first, end in pairwise(cuts):
                part = replace(whole, from_lod=int(first), payloads=whole.payloads[first:end])
                out += [part] * (1 + (rng.random() < 0.2))
        rng.shuffle(out)  # type: ignore[arg-type]
        return out


def written(folder: Path, of: Manifest, frames: list[list[TilePayloads]]) -> Clip:
    """``frames`` as a bundle."""
    place = str(folder / "clip.cags")
    with BundleWriter(place) as writer:
        for gof in range(len(of.gof_starts)):
            group = writer.open_gof(of.gof_starts[gof], of.lods)
            for frame in of.gof_frames(gof):
                group.frame(frames[frame], np.zeros(0, np.int32), b"")
            group.close()
        writer.codebooks(books().to_bytes())
        writer.commit(of)
    return Clip(BundleReader.open(place), frames)


def random_frames(rng: np.random.Generator, of: Manifest) -> list[list[TilePayloads]]:
    """Looks that take splats from each other, updates, and motion of tiles of looks that came before in the group."""
    frames: list[list[TilePayloads]] = []
    tiles: dict[tuple[int, int], Anchors] = {}
    for frame in range(of.frames):
        here: list[TilePayloads] = []
        if frame in of.gof_starts:
            tiles = {}
        free = rng.permutation(CAPACITY)
        for _ in range(2 if not tiles else int(rng.random() < 0.4)):
            ids, free = sorted(free[:4].tolist()), free[4:]
            here.append(looks(ids, 0.0, rng))
            tiles[frame, len(here) - 1] = decoded_anchors(of, here[-1])
        if rng.random() < 0.5:
            here.append(_random_update(rng, sorted(rng.permutation(CAPACITY)[:5].tolist())))
        here += [_random_motion(rng, key, anchors) for key, anchors in tiles.items() if rng.random() < 0.4]
        frames.append(here)
    return frames


def decoded_anchors(of: Manifest, tile: TilePayloads) -> Anchors:
    """What motion of a ``tile`` of looks is told by."""
    state = SvqTileCodec(of, books().to_bytes()).open_tile(tile.payloads[0])
    anchors = anchors_of(state)  # type: ignore[arg-type]
    assert anchors is not None
    return anchors


def _random_update(rng: np.random.Generator, ids: list[int]) -> TilePayloads:
    names = ("scale", "opacity", "sh0")
    changed = {name: rng.random(len(ids)) < 0.6 for name in names}
    codes = {name: rng.integers(0, 4 if name == "scale" else 8, len(ids)) for name in names}
    return update(ids, changed, codes, rng.integers(1, 5, len(ids)))


def _random_motion(rng: np.random.Generator, of: tuple[int, int], anchors: Anchors) -> TilePayloads:
    span, count = int(rng.integers(1, 5)), len(anchors)
    moves = np.cumsum(rng.normal(size=(span + 1, count, 3)) * 20, axis=0)
    turns = np.cumsum(rng.normal(size=(span + 1, count, 4)) * 5, axis=0) if rng.random() < 0.5 else None
    stands = np.flatnonzero(rng.random(count) < rng.choice([0.0, 0.6]))
    for part in (moves, turns):
        if part is not None:
            part[:, stands] = part[0, stands] * rng.integers(0, 2)
    lives = rng.integers(0, span + 2, count).astype(np.uint8) if rng.random() < 0.4 else None
    fades = None
    if rng.random() < 0.3:
        fades = np.stack([rng.integers(0, 49, count), rng.integers(-4, 5, count)], axis=1)
    payloads = encode(of, anchors, moves, turns, starts=bool(rng.random() < 0.5), lives=lives, fades=fades)
    return TilePayloads(count, None, BOX, payloads, TileKind.MOTION, of, span)
