"""A chunk of motion, both ways: what the splats of one tile of looks do from one frame to a later one.

Everything is said against the tile's own positions and rotations, which a client has from the tile's first level on: a
chunk needs no other chunk, and nothing drifts. Level 0 says who ends when, who fades how, how many levels there are,
and coarse residuals; each further level refines the residuals by four. Levels beyond the chunk's own are empty. Layout:
``docs/bundle.md``.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cags_common.coding.packing import squeeze, unsqueeze
from cags_common.errors import DecodeError
from cags_common.geometry import F32, F64
from cags_common.motion.knots import I32, knots
from cags_common.motion.neighbours import Anchors, Neighbours
from cags_common.motion.symbols import Samples, SymbolReader, SymbolWriter, Tree, fade_tables, life_tables

VERSION = 11
LEVELS = 4
"""Levels of a chunk at most."""

REFINEMENT = 4
"""A level's unit is so many times the next one's."""

MAX_SPAN = 64
MAX_SPLATS = 65_536
MAX_SAMPLES = 1 << 20
"""Splats times samples of the span: what a payload of a few bytes may claim takes 28 MiB."""

MAX_FINER = 10
"""A chunk's units are those of its tile, halved so often at most."""

MAX_UNITS = (1 << 25) - (1 << 10)
"""Residuals, finest units: fixed point fits 32 bits."""

STARTS, LIVES, FADES, STILLS, CURVED_MOVES, CURVED_TURNS = 1, 2, 4, 8, 16, 32
FLAGS = STARTS | LIVES | FADES | STILLS | CURVED_MOVES | CURVED_TURNS
DEADZONES = (0.2, 0.1, 0.15, 0.15)
"""Of each level, units beyond half a one up to which a residual is none: most of the bits tell such noise."""

FEW_STILL = 0.5
"""Share of splats that keep their places up to which nothing is said of them."""

FADE_WIDTHS = 2.0 ** (np.arange(48) / 4 - 3)
"""Standard deviations of a fade, frames; index 0 of the payload stands for none."""

FADE_STEP = 4
"""Centres of fades are in this part of their width."""

_HEAD = struct.Struct("<BBBBBIIIBBIII")
"""Version, flags, span, levels of positions and of rotations, looks' frame and tile, splats, halvings of the units of
positions and of rotations, bytes of who moves, of the escapes' and of the symbols.
"""


@dataclass(frozen=True, eq=False)
class Chunk:
    """What a payload of level 0 says; residuals of further levels are added to ``moves`` and ``turns``."""

    looks: tuple[int, int]
    """Media frame and tile of the looks that move."""
    span: int
    splats: int
    lives: NDArray[np.uint8] | None
    """[n] frames from the first for which a splat is there; ``span`` + 1: beyond the span. None: all of them are."""
    fades: F32 | None
    """[n, 2] centre and standard deviation of each splat's fade, frames from the first; infinite: none."""
    moves: I32 | None  # [span + 1, n, 3] fixed point, finest units
    turns: I32 | None  # [span + 1, n, 4]
    starts: bool
    """Whether the samples of the first frame are coded; else they are zero."""
    finer: tuple[int, int] = (0, 0)
    """How often the units of ``moves`` and of ``turns`` are the tile's halved."""
    curved: tuple[bool, bool] = (False, False)
    """Whether middles of ``moves`` and of ``turns`` are told against curves, not lines."""


def encode(
    looks: tuple[int, int],
    anchors: Anchors,
    moves: F64 | None,
    turns: F64 | None,
    *,
    starts: bool,
    lives: NDArray[np.uint8] | None = None,
    fades: NDArray[np.int64] | None = None,
    finer: tuple[int, int] = (0, 0),
    told: tuple[int, int] = (LEVELS, LEVELS),
    curved: tuple[bool, bool] = (False, False),
    deadzones: tuple[Sequence[float], Sequence[float]] = (DEADZONES, DEADZONES),
    native: bool | None = None,
) -> tuple[bytes, ...]:
    """The payload of each level. ``anchors`` [n] are the looks, decoded. ``moves`` [span + 1, n, 3] and ``turns``
    [span + 1, n, 4] are in finest units, those of ``turns`` against (1, 0, 0, 0); ``fades`` [n, 2] are an index of
    :data:`FADE_WIDTHS` plus one (0: none) and the centre in ``FADE_STEP`` parts of the width, from the middle of the
    life. ``finer`` says how often the finest units of ``moves`` and of ``turns`` are the tile's halved, ``told`` how
    many levels say anything of them, ``curved`` whether their middles are told against curves, ``deadzones`` those of
    each level. Payloads of levels that say nothing are empty.

    ``native`` None takes the kernel where there is one, to the same bytes. Raises ``ValueError`` for arrays that do not
    fit each other, are beyond the format's bounds or not finite.
    """
    given = (("moves", moves), ("turns", turns))
    wanted = {name: np.ascontiguousarray(part) for name, part in given if part is not None}
    span, splats = _bounds(wanted)
    _check_sides(span, splats, lives, fades)
    _check_anchors(anchors, splats, ValueError)
    if not all(0 <= halvings <= MAX_FINER for halvings in finer):
        raise ValueError(f"motion: units halved {finer} times, 0 to {MAX_FINER} expected")
    if not all(0 <= levels <= LEVELS for levels in told):
        raise ValueError(f"motion: {told} levels say something, 0 to {LEVELS} expected")
    parts = [
        _Wanted(wanted[name], told[turn], deadzones[turn], curved[turn], bool(turn))
        for turn, name in enumerate(("moves", "turns"))
        if name in wanted and told[turn]
    ]
    flags = STARTS * starts | LIVES * (lives is not None) | FADES * (fades is not None)
    flags |= sum((CURVED_TURNS if part.turn else CURVED_MOVES) for part in parts if part.curved)
    movers = _movers(parts)
    if movers is not None:
        flags |= STILLS
        anchors, parts = anchors.take(movers), [part.take(movers) for part in parts]
    near = Neighbours.of(anchors, native=native)
    samples = [
        Samples.untold(Tree.of(knots(span, start=starts, curved=part.curved), anchors, near, turn=part.turn), span)
        for part in parts
    ]
    counts = [max((part.levels for part in parts if part.turn == turn), default=0) for turn in (False, True)]
    payloads, count = [], max(1, *counts)
    for level in range(count):
        writer = SymbolWriter(native=native)
        if level == 0:
            _write_sides(writer, span, lives, fades)
        for part, sample in zip(parts, samples, strict=True):
            if level < part.levels:
                writer.tree(sample, part.values, REFINEMENT ** (LEVELS - 1 - level), part.deadzones[level])
        escapes, symbols = writer.to_bytes()
        sizes = len(escapes), len(symbols)
        if level == 0:
            who = b"" if movers is None else squeeze(np.packbits(movers).tobytes())
            head = _HEAD.pack(VERSION, flags, span, *counts, *looks, splats, *finer, len(who), *sizes) + who
        else:
            head = struct.pack("<I", len(escapes))
        payloads.append(head + escapes + symbols)
    return *payloads, *(b"" for _ in range(count, LEVELS))


@dataclass(frozen=True, slots=True, eq=False)
class _Wanted:
    """Positions or rotations to be told."""

    values: F64  # [span + 1, n, c]
    levels: int
    deadzones: Sequence[float]
    curved: bool
    turn: bool

    def take(self, rows: NDArray[np.bool_]) -> _Wanted:
        """Those of ``rows`` [n]."""
        return replace(self, values=np.ascontiguousarray(self.values[:, rows]))

    def moves(self) -> NDArray[np.bool_]:
        """[n] splats of which a level says anything: not all values fall into the dead zone of every level."""
        units = (REFINEMENT ** (LEVELS - 1 - level) for level in range(self.levels))
        least = min(unit * (0.5 + zone) for unit, zone in zip(units, self.deadzones, strict=False))
        moves: NDArray[np.bool_] = (np.abs(self.values) >= least).any(axis=(0, 2))
        return moves


def _movers(parts: Sequence[_Wanted]) -> NDArray[np.bool_] | None:
    """[n] splats of which a level says anything; None where they are most."""
    if not parts:
        return None
    moves: NDArray[np.bool_] = np.logical_or.reduce([part.moves() for part in parts])
    return moves if moves.sum() < (1 - FEW_STILL) * len(moves) else None


def _bounds(given: dict[str, F64]) -> tuple[int, int]:
    """Span and splats. Raises ``ValueError``."""
    shapes = {part.shape[:2] for part in given.values()}
    if len(shapes) != 1:
        raise ValueError(
            f"motion: positions and rotations have {sorted(shapes)} samples; one kind for both is expected"
        )
    samples, splats = shapes.pop()
    if not 1 <= samples - 1 <= MAX_SPAN or splats > MAX_SPLATS or samples * splats > MAX_SAMPLES:
        raise ValueError(
            f"motion: {samples} samples of {splats} splats; beyond {MAX_SPAN + 1}, {MAX_SPLATS} or together"
        )
    for name, part in given.items():
        if part.shape[2] != (4 if name == "turns" else 3):
            raise ValueError(f"motion: {name} have {part.shape[2]} parts")
        if part.size and not (part.max() <= MAX_UNITS and part.min() >= -MAX_UNITS):
            raise ValueError(f"motion: {name} are not finite or beyond {MAX_UNITS} units; begin a new splat instead")
    return samples - 1, splats


def _check_sides(span: int, splats: int, lives: NDArray[np.uint8] | None, fades: NDArray[np.int64] | None) -> None:
    if lives is not None and (len(lives) != splats or int(lives.max(initial=0)) > span + 1):
        raise ValueError(f"motion: {len(lives)} lives of up to {lives.max(initial=0)} frames for {splats} splats")
    if fades is not None:
        widths, centres = fades[:, 0], fades[:, 1]
        legal = (
            len(fades) == splats and int(widths.min(initial=0)) >= 0 and int(widths.max(initial=0)) <= len(FADE_WIDTHS)
        )
        if not legal or int(np.abs(centres).max(initial=0)) >= 1 << 31:
            raise ValueError(f"motion: {len(fades)} fades for {splats} splats, or widths or centres beyond bounds")


def _check_anchors(anchors: Anchors, splats: int, error: type[Exception]) -> None:
    """Raises ``error``."""
    if len(anchors) != splats:
        raise error(f"motion: {splats} splats move, and the looks have {len(anchors)}")
    try:
        anchors.check()
    except ValueError as reason:
        raise error(f"motion: {reason}") from None


def _write_sides(
    writer: SymbolWriter, span: int, lives: NDArray[np.uint8] | None, fades: NDArray[np.int64] | None
) -> None:
    if lives is not None:
        writer.plain(life_tables(len(lives)), lives)
    if fades is not None:
        widths, centres = fade_tables(span, len(fades), lives)
        writer.plain(widths, fades[:, 0].astype(np.uint8))
        fading = np.flatnonzero(fades[:, 0])
        writer.signed(centres[fading], fades[fading, 1])


class ChunkDecoder:
    """A chunk as far as it has come. Not thread-safe."""

    def __init__(self, payload: bytes | memoryview, anchors: Anchors, *, native: bool | None = None) -> None:
        """Decode level 0; ``anchors`` [n] are the looks that move. ``native`` None takes the kernel where there is one.

        Raises :class:`DecodeError`.
        """
        head, who, escapes, symbols = _sections(payload)
        _check_anchors(anchors, head.splats, DecodeError)
        self._native, self._movers = native, _read_movers(head, who)
        self._trees = _Trees.of(head, anchors, self._movers, native=native)
        reader = SymbolReader(escapes, symbols, native=native)
        self._blank = self._opened(head, reader)
        self._chunk: Chunk | None = None
        self._read, self._count = 1, max(1, *head.levels)
        self._drop_when_whole()

    @property
    def chunk(self) -> Chunk:
        """The motion, at the levels there are. Made when it is first asked for: levels often come together."""
        if self._chunk is None:
            self._chunk = self._with_trees(self._blank)
        return self._chunk

    @property
    def levels(self) -> int:
        """Number of levels that there are, from the first on; those that are empty count from the last full one on."""
        return self._read if self._read < self._count else LEVELS

    @property
    def looks(self) -> tuple[int, int]:
        """Media frame and tile of the looks that move."""
        return self._blank.looks

    @property
    def splats(self) -> int:
        """Number of splats of the looks."""
        return self._blank.splats

    @property
    def nbytes(self) -> int:
        """What it keeps for further levels, besides the chunk."""
        return self._trees.nbytes

    def fork(self) -> ChunkDecoder:
        """Another decoder of what has come; what is added to one of the two does not change the other."""
        return copy(self)

    def add_level(self, payload: bytes | memoryview) -> None:
        """Take the next level. Raises :class:`DecodeError`, and then nothing is changed."""
        if self._read >= self._count:
            if not len(payload):
                return
            raise DecodeError(f"motion: level {self._read} of {self._count} is too much")
        reader = SymbolReader(*_finer_sections(payload), native=self._native)
        trees = self._trees.copy()
        _read(reader, trees, self._read)
        reader.finish()
        self._trees, self._chunk = trees, None
        self._read += 1
        self._drop_when_whole()

    def _drop_when_whole(self) -> None:
        if self._read >= self._count:
            self._chunk = self.chunk
            self._trees = _Trees(self._trees.levels, (None, None))

    def _opened(self, head: _Head, reader: SymbolReader) -> Chunk:
        """Read level 0; what is told of positions and rotations is in the trees."""
        n = head.splats
        lives = reader.plain(life_tables(n)) if head.has(LIVES) else None
        if lives is not None and int(lives.max(initial=0)) > head.span + 1:
            raise DecodeError(f"motion: a life of {int(lives.max())} frames in a span of {head.span}")
        fades = _read_fades(reader, head, lives) if head.has(FADES) else None
        blank = Chunk(head.looks, head.span, n, lives, fades, None, None, head.has(STARTS), head.finer, head.curved)
        _read(reader, self._trees, 0)
        reader.finish()
        return blank

    def _with_trees(self, chunk: Chunk) -> Chunk:
        moves, turns = (None if part is None else self._of_all(part.values, chunk.splats) for part in self._trees.parts)
        return replace(chunk, moves=moves, turns=turns)

    def _of_all(self, samples: I32, splats: int) -> I32:
        """``samples`` [span + 1, movers, c] as of all splats [span + 1, n, c]."""
        if self._movers is None:
            return samples
        out = np.zeros((len(samples), splats, samples.shape[2]), np.int32)
        out[:, self._movers] = samples
        return out


@dataclass(frozen=True, slots=True)
class _Head:
    flags: int
    span: int
    levels: tuple[int, int]
    """Levels that say anything of positions and of rotations."""
    looks: tuple[int, int]
    splats: int
    finer: tuple[int, int]

    def has(self, flag: int) -> bool:
        return bool(self.flags & flag)

    @property
    def curved(self) -> tuple[bool, bool]:
        """Whether middles of positions and of rotations are told against curves."""
        return self.has(CURVED_MOVES), self.has(CURVED_TURNS)


@dataclass(frozen=True, slots=True, eq=False)
class _Trees:
    levels: tuple[int, int]
    parts: tuple[Samples | None, Samples | None]
    """Positions and rotations; None where nothing is told of them."""

    @staticmethod
    def of(head: _Head, anchors: Anchors, movers: NDArray[np.intp] | None, *, native: bool | None) -> _Trees:
        """Nothing told yet; ``anchors`` [n] are the looks."""
        if not any(head.levels):
            return _Trees(head.levels, (None, None))
        moving = anchors if movers is None else anchors.take(movers)
        near = Neighbours.of(moving, native=native)

        def part(*, turn: bool) -> Samples | None:
            order = knots(head.span, start=head.has(STARTS), curved=head.curved[turn])
            return Samples.untold(Tree.of(order, moving, near, turn=turn), head.span) if head.levels[turn] else None

        return _Trees(head.levels, (part(turn=False), part(turn=True)))

    def copy(self) -> _Trees:
        """One that changes apart."""
        moves, turns = (None if part is None else part.copy() for part in self.parts)
        return _Trees(self.levels, (moves, turns))

    @property
    def nbytes(self) -> int:
        """Of samples, and of neighbours, which both parts share."""
        parts = [part for part in self.parts if part is not None]
        near = parts[0].tree.near if parts else None
        each = sum(part.values.nbytes + part.told.nbytes + part.tree.units.nbytes for part in parts)
        return each + (0 if near is None else near.rows.nbytes + near.fits.nbytes)

    def told_at(self, level: int) -> dict[str, Samples]:
        """The parts of which ``level`` tells."""
        named = zip(("positions", "rotations"), self.parts, self.levels, strict=True)
        return {name: part for name, part, levels in named if part is not None and level < levels}


def read_looks(payload: bytes | memoryview) -> tuple[int, int]:
    """Media frame and tile of the looks that a payload of level 0 moves. Raises :class:`DecodeError`."""
    return _sections(payload)[0].looks


def _sections(payload: bytes | memoryview) -> tuple[_Head, memoryview, memoryview, memoryview]:
    view = memoryview(payload)
    if len(view) < _HEAD.size:
        raise DecodeError(f"motion: {len(view)} bytes are too few for a chunk")
    version, flags, span, moves, turns, frame, tile, splats, finer, finer_turns, *sizes = _HEAD.unpack_from(view)
    bent = (flags & CURVED_MOVES and not moves) or (flags & CURVED_TURNS and not turns)
    if version != VERSION or max(moves, turns) > LEVELS or flags & ~FLAGS or bent:
        raise DecodeError(
            f"motion: version {version}, {moves} and {turns} levels, flags {flags}; this program reads {VERSION}"
        )
    small = splats <= MAX_SPLATS and splats * (span + 1) <= MAX_SAMPLES
    bounds = 1 <= span <= MAX_SPAN and small and max(finer, finer_turns) <= MAX_FINER
    if not bounds or sum(sizes) != len(view) - _HEAD.size:
        raise DecodeError(f"motion: claims a span of {span}, {splats} splats, {sum(sizes)} bytes; beyond bounds")
    who = _HEAD.size + sizes[0]
    escapes = who + sizes[1]
    head = _Head(flags, span, (moves, turns), (frame, tile), splats, (finer, finer_turns))
    return head, view[_HEAD.size : who], view[who:escapes], view[escapes:]


def _finer_sections(payload: bytes | memoryview) -> tuple[memoryview, memoryview]:
    """Large numbers and symbols of a payload of a further level. Raises :class:`DecodeError`."""
    view = memoryview(payload)
    escapes = 4 + struct.unpack_from("<I", view)[0] if len(view) >= 4 else 0
    if not 4 <= escapes <= len(view):
        raise DecodeError("motion: a level is cut short")
    return view[4:escapes], view[escapes:]


def spent(payloads: Sequence[bytes | memoryview], anchors: Anchors) -> dict[str, int]:
    """Bytes by what they tell, of the first ``payloads`` of a chunk. Read by numpy, which takes its time.

    ``anchors`` [n] are the looks. Raises :class:`DecodeError`.
    """
    head, who, *sections = _sections(payloads[0])
    _check_anchors(anchors, head.splats, DecodeError)
    movers = _read_movers(head, who)
    trees = _Trees.of(head, anchors, movers, native=None)
    out = {"heads and tables": _HEAD.size, "movers": len(who), "large numbers": 0}
    for level, payload in enumerate(payloads):
        escapes, symbols = _finer_sections(payload) if level else sections
        reader, before = SymbolReader(escapes, symbols, native=False), 0
        if level == 0 and head.has(LIVES | FADES):
            lives = reader.plain(life_tables(head.splats)) if head.has(LIVES) else None
            out["lives"], before = reader.read_bytes, reader.read_bytes
            if head.has(FADES):
                _read_fades(reader, head, lives)
            out["fades"], before = reader.read_bytes - before, reader.read_bytes
        for name, part in trees.told_at(level).items():
            reader.tree(part, REFINEMENT ** (LEVELS - 1 - level))
            out[f"{name}, level {level}"], before = reader.read_bytes - before, reader.read_bytes
        out["large numbers"] += len(escapes)
        out["heads and tables"] += 4 * (level > 0) + len(symbols) - reader.read_bytes
    return out


def _read(reader: SymbolReader, trees: _Trees, level: int) -> None:
    """Take ``trees`` on by ``level``."""
    for part in trees.told_at(level).values():
        reader.tree(part, REFINEMENT ** (LEVELS - 1 - level))


def _read_movers(head: _Head, who: memoryview) -> NDArray[np.intp] | None:
    """Rows [m] of the splats of which levels speak; None: of all. Raises :class:`DecodeError`."""
    if not head.has(STILLS):
        if len(who):
            raise DecodeError("motion: says who moves, and that all do")
        return None
    raw = unsqueeze(who, -(-head.splats // 8), "motion: who moves")
    return np.flatnonzero(np.unpackbits(np.frombuffer(raw, np.uint8), count=head.splats))


def _read_fades(reader: SymbolReader, head: _Head, lives: NDArray[np.uint8] | None) -> F32:
    of_widths, of_centres = fade_tables(head.span, head.splats, lives)
    widths = reader.plain(of_widths)
    if int(widths.max(initial=0)) > len(FADE_WIDTHS):
        raise DecodeError(f"motion: a fade's width has index {int(widths.max())}, at most {len(FADE_WIDTHS)}")
    fading = np.flatnonzero(widths)
    out = np.full((head.splats, 2), np.inf, np.float32)
    out[:, 0] = 0.0
    centres = reader.signed(of_centres[fading])
    width = FADE_WIDTHS[widths[fading].astype(np.int64) - 1]
    out[fading, 0] = middle_of_life(head.span, lives, fading) + centres * width / FADE_STEP
    out[fading, 1] = width
    return out


def middle_of_life(span: int, lives: NDArray[np.uint8] | None, rows: NDArray[np.intp]) -> F64:
    """Frames [m] from a chunk's first to the middle of the lives of ``rows`` [m] within it."""
    if lives is None:
        return np.full(len(rows), span / 2)
    middle: F64 = (lives[rows].astype(np.float64) - 1) / 2
    return middle
