"""A chunk of motion, both ways: what the splats of one tile of looks do from one frame to a later one.

Everything is said against the tile's own positions and rotations, which a client has from the tile's first level on: a
chunk needs no other chunk, and nothing drifts. Level 0 says who ends when, who fades how, how blocks of splats move as
rigid bodies, and coarse residuals; each further level refines the residuals by four. Layout: ``docs/bundle.md``.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cags_common import rans
from cags_common.errors import DecodeError
from cags_common.geometry import F32, F64
from cags_common.motion.knots import FRACTION_BITS, I32, Knot, knots, predicted, quantise
from cags_common.packing import squeeze, unsqueeze

VERSION = 1
LEVELS = 2
REFINEMENT = 4
"""A level's unit is so many times the next one's."""

MAX_SPAN = 64
MAX_SPLATS = 65_536
MAX_BLOCK = 4_096
STARTS, TURNS, LIVES, FADES, MOVES = 1, 2, 4, 8, 16
DEADZONE = 0.1

FADE_WIDTHS = 2.0 ** (np.arange(48) / 4 - 3)
"""Standard deviations of a fade, frames; index 0 of the payload stands for none."""

FADE_STEP = 4
"""Centres of fades are in this part of their width."""

_HEAD = struct.Struct("<BBBBIIIHxxfIII")
"""Version, flags, span, levels, looks' frame and tile, splats, block, metres a unit of the blocks' shifts, bytes of the
blocks, of the escapes' and of the symbols.
"""
_SYMBOL, _ESCAPE = 255, 254
_LIFE, _WIDTH, _CENTRE, _MOVE, _TURN, _REAL, _TABLES = 0, 1, 2, 3, 15, 27, 31
"""First tables of: lives, widths and centres of fades, positions (kind of knot, activity), rotations, their real part."""

TURN_UNIT = 1 / 4096
"""Unit of the blocks' rotations: Gibbs vectors, tangents of half the angle."""


@dataclass(frozen=True, eq=False)
class Blocks:
    """Rigid motion of runs of ``size`` splats, in the tile's order, at each sample of the span."""

    size: int
    unit: float
    """Metres a unit of ``shifts``."""
    shifts: I32  # [span + 1, blocks, 3]
    turns: I32  # [span + 1, blocks, 3] Gibbs vectors in TURN_UNIT


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
    blocks: Blocks | None
    moves: I32 | None  # [span + 1, n, 3] fixed point, finest units
    turns: I32 | None  # [span + 1, n, 4]
    starts: bool
    """Whether the samples of the first frame are coded; else they are zero."""


def encode(
    looks: tuple[int, int],
    moves: F64 | None,
    turns: F64 | None,
    *,
    starts: bool,
    lives: NDArray[np.uint8] | None = None,
    fades: NDArray[np.int64] | None = None,
    blocks: Blocks | None = None,
) -> tuple[bytes, ...]:
    """The payload of each level. ``moves`` [span + 1, n, 3] and ``turns`` [span + 1, n, 4] are in finest units, those
    of ``turns`` against (1, 0, 0, 0); ``fades`` [n, 2] are an index of :data:`FADE_WIDTHS` plus one (0: none) and the
    centre in ``FADE_STEP`` parts of the width, from the middle of the life.
    """
    given = moves if moves is not None else turns
    assert given is not None
    span, splats = len(given) - 1, given.shape[1]
    order = knots(span, start=starts)
    flags = STARTS * starts | MOVES * (moves is not None) | TURNS * (turns is not None)
    flags |= LIVES * (lives is not None) | FADES * (fades is not None)
    head_symbols = _Symbols()
    if lives is not None:
        head_symbols.plain(np.full(splats, _LIFE, np.uint8), lives)
    if fades is not None:
        head_symbols.plain(np.full(splats, _WIDTH, np.uint8), fades[:, 0].astype(np.uint8))
        fading = fades[fades[:, 0] > 0, 1]
        head_symbols.signed(np.full(len(fading), _CENTRE, np.uint8), fading)
    left = {name: part.copy() for name, part in (("moves", moves), ("turns", turns)) if part is not None}
    payloads = []
    for level in range(LEVELS):
        symbols = head_symbols if level == 0 else _Symbols()
        unit = REFINEMENT ** (LEVELS - 1 - level)
        for name, part in left.items():
            residuals, samples = quantise(part / unit, order, DEADZONE if level == 0 else 0.0)
            symbols.tree(order, residuals, turn=name == "turns")
            part -= samples * (unit / (1 << FRACTION_BITS))
        body = symbols.to_bytes()
        if level == 0:
            rigid = _blocks_bytes(blocks)
            size, metres = (blocks.size, blocks.unit) if blocks else (0, 0.0)
            head = _HEAD.pack(VERSION, flags, span, LEVELS, *looks, splats, size, metres, len(rigid), *symbols.sizes)
            payloads.append(head + rigid + body)
        else:
            payloads.append(struct.pack("<I", symbols.sizes[0]) + body)
    return tuple(payloads)


class _Symbols:
    """Symbols of one level on their way into bytes."""

    def __init__(self) -> None:
        self._parts: list[tuple[NDArray[np.uint8], NDArray[np.uint8]]] = []
        self._escapes: list[I32] = []
        self.sizes = (0, 0)
        """Bytes of the escapes and of the symbols."""

    def plain(self, tables: NDArray[np.uint8], values: NDArray[np.uint8]) -> None:
        self._parts.append((tables, values))

    def signed(self, tables: NDArray[np.uint8], values: NDArray[np.int64] | I32) -> None:
        folded = np.where(values < 0, -2 * values.astype(np.int64) - 1, 2 * values.astype(np.int64))
        large = folded >= _ESCAPE
        self._escapes.append(values[large].astype(np.int32))
        self._parts.append((tables, np.where(large, _ESCAPE, folded).astype(np.uint8)))

    def tree(self, order: tuple[Knot, ...], residuals: Sequence[I32], *, turn: bool) -> None:
        activity: dict[int, NDArray[np.uint8]] = {}
        for knot, residual in zip(order, residuals, strict=True):
            self.signed(_tree_tables(knot, activity, residual.shape, turn=turn), residual.reshape(-1))
            activity[knot.at] = _activity(residual)

    def to_bytes(self) -> bytes:
        escapes = np.concatenate([np.zeros(0, np.int32), *self._escapes]).astype("<i4").tobytes()
        symbols = rans.encode(self._parts)
        self.sizes = len(escapes), len(symbols)
        return escapes + symbols


def _activity(residual: I32) -> NDArray[np.uint8]:
    """Four classes [n] of how much a knot's residuals [n, c] are."""
    total = np.minimum(np.abs(residual), 7).sum(axis=1)
    return np.searchsorted(np.array([0, 2, 6]), total, side="left").astype(np.uint8)


def _tree_tables(
    knot: Knot, activity: dict[int, NDArray[np.uint8]], shape: tuple[int, ...], *, turn: bool
) -> NDArray[np.uint8]:
    """The table of each residual [n * c] of a knot."""
    splats, parts = shape
    classes = activity[knot.parent] if knot.parent in activity else np.zeros(splats, np.uint8)
    tables = np.repeat(((_TURN if turn else _MOVE) + 4 * knot.kind + classes).astype(np.uint8)[:, None], parts, axis=1)
    if turn:
        tables[:, 0] = _REAL + classes
    return tables.reshape(-1)


class ChunkDecoder:
    """A chunk as far as it has come. Not thread-safe."""

    def __init__(self, payload: bytes | memoryview) -> None:
        """Decode level 0. Raises :class:`DecodeError`."""
        head, rigid, escapes, symbols = _sections(payload)
        self.chunk, self.levels = _opened(head, rigid, escapes, symbols), 1

    @property
    def looks(self) -> tuple[int, int]:
        """Media frame and tile of the looks that move."""
        return self.chunk.looks

    def add_level(self, payload: bytes | memoryview) -> None:
        """Take the next level. Raises :class:`DecodeError`, and then nothing is changed."""
        view = memoryview(payload)
        if self.levels >= LEVELS or len(view) < 4:
            raise DecodeError(f"motion: level {self.levels} of {LEVELS} is too much or cut short")
        escapes = 4 + struct.unpack_from("<I", view)[0]
        if escapes > len(view):
            raise DecodeError("motion: a level's escapes are cut short")
        chunk, reader = self.chunk, _Reader(view[4:escapes], view[escapes:])
        trees = [
            _read_tree(reader, part, chunk, turn=part.shape[2] == 4)
            for part in (chunk.moves, chunk.turns)
            if part is not None
        ]
        reader.finish()
        unit = REFINEMENT ** (LEVELS - 1 - self.levels)
        for part, tree in zip((p for p in (chunk.moves, chunk.turns) if p is not None), trees, strict=True):
            part += tree * np.int32(unit)
        self.levels += 1


@dataclass(frozen=True, slots=True)
class _Head:
    flags: int
    span: int
    looks: tuple[int, int]
    splats: int
    block: int
    unit: float

    def has(self, flag: int) -> bool:
        return bool(self.flags & flag)


def read_looks(payload: bytes | memoryview) -> tuple[int, int]:
    """Media frame and tile of the looks that a payload of level 0 moves. Raises :class:`DecodeError`."""
    return _sections(payload)[0].looks


def _sections(payload: bytes | memoryview) -> tuple[_Head, memoryview, memoryview, memoryview]:
    view = memoryview(payload)
    if len(view) < _HEAD.size:
        raise DecodeError(f"motion: {len(view)} bytes are too few for a chunk")
    version, flags, span, levels, frame, tile, splats, block, unit, *sizes = _HEAD.unpack_from(view)
    if version != VERSION or levels != LEVELS or flags & ~(STARTS | TURNS | LIVES | FADES | MOVES):
        raise DecodeError(f"motion: version {version}, {levels} levels, flags {flags}; this program reads {VERSION}")
    bounds = 1 <= span <= MAX_SPAN and splats <= MAX_SPLATS and block <= MAX_BLOCK and 0.0 <= unit <= 1e30
    if not bounds or sum(sizes) != len(view) - _HEAD.size or sizes[1] % 4:
        raise DecodeError(f"motion: claims a span of {span}, {splats} splats, {sum(sizes)} bytes; beyond bounds")
    ends = [_HEAD.size, *(_HEAD.size + sum(sizes[: i + 1]) for i in range(3))]
    parts = (view[first:end] for first, end in zip(ends, ends[1:], strict=False))
    return (_Head(flags, span, (frame, tile), splats, block, unit), *parts)  # type: ignore[return-value]


def _opened(head: _Head, rigid: memoryview, escapes: memoryview, symbols: memoryview) -> Chunk:
    reader, n = _Reader(escapes, symbols), head.splats
    lives = reader.plain(np.full(n, _LIFE, np.uint8)) if head.has(LIVES) else None
    if lives is not None and int(lives.max(initial=0)) > head.span + 1:
        raise DecodeError(f"motion: a life of {int(lives.max())} frames in a span of {head.span}")
    fades = _read_fades(reader, head, lives) if head.has(FADES) else None
    shape = (head.span + 1, n)
    blank = Chunk(head.looks, head.span, n, lives, fades, _read_blocks(head, rigid), None, None, head.has(STARTS))
    moves = _read_tree(reader, np.zeros((*shape, 3), np.int32), blank, turn=False) if head.has(MOVES) else None
    turns = _read_tree(reader, np.zeros((*shape, 4), np.int32), blank, turn=True) if head.has(TURNS) else None
    reader.finish()
    unit = np.int32(REFINEMENT ** (LEVELS - 1))
    return Chunk(
        *(blank.looks, head.span, n, lives, fades, blank.blocks),
        None if moves is None else moves * unit,
        None if turns is None else turns * unit,
        blank.starts,
    )


class _Reader:
    """Reads the symbols of one level."""

    def __init__(self, escapes: memoryview, symbols: memoryview) -> None:
        if len(escapes) % 4:
            raise DecodeError("motion: escapes are cut short")
        self._escapes, self._at = np.frombuffer(escapes, "<i4"), 0
        self._symbols = rans.decoder(symbols)

    def plain(self, tables: NDArray[np.uint8]) -> NDArray[np.uint8]:
        return self._symbols.take(tables)

    def signed(self, tables: NDArray[np.uint8]) -> I32:
        folded = self._symbols.take(tables).astype(np.int32)
        values = np.where(folded & 1, -((folded + 1) >> 1), folded >> 1).astype(np.int32)
        large = np.flatnonzero(folded == _ESCAPE)
        if len(large):
            if self._at + len(large) > len(self._escapes):
                raise DecodeError("motion: large residuals are missing")
            values[large] = self._escapes[self._at : self._at + len(large)]
            self._at += len(large)
        return values

    def finish(self) -> None:
        self._symbols.finish()
        if self._at != len(self._escapes):
            raise DecodeError("motion: large residuals are left over")


def _read_tree(reader: _Reader, like: I32, chunk: Chunk, *, turn: bool) -> I32:
    """Samples of one level, of the shape of ``like``, in 1/64 of the level's unit."""
    samples, activity = np.zeros_like(like), dict[int, NDArray[np.uint8]]()
    for knot in knots(chunk.span, start=chunk.starts):
        shape = like.shape[1:]
        residual = reader.signed(_tree_tables(knot, activity, shape, turn=turn)).reshape(shape)
        activity[knot.at] = _activity(residual)
        samples[knot.at] = predicted(samples, knot) + (residual << FRACTION_BITS)
    return samples


def _read_fades(reader: _Reader, head: _Head, lives: NDArray[np.uint8] | None) -> F32:
    widths = reader.plain(np.full(head.splats, _WIDTH, np.uint8))
    if int(widths.max(initial=0)) > len(FADE_WIDTHS):
        raise DecodeError(f"motion: a fade's width has index {int(widths.max())}, at most {len(FADE_WIDTHS)}")
    fading = np.flatnonzero(widths)
    out = np.full((head.splats, 2), np.inf, np.float32)
    out[:, 0] = 0.0
    centres = reader.signed(np.full(len(fading), _CENTRE, np.uint8))
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


def _blocks_bytes(blocks: Blocks | None) -> bytes:
    """Differences from sample to sample, as byte planes."""
    if blocks is None:
        return b""
    both = np.concatenate([blocks.shifts, blocks.turns], axis=2)
    steps = np.diff(both, axis=0, prepend=np.zeros((1, *both.shape[1:]), np.int32))
    columns = np.ascontiguousarray(steps.transpose(2, 1, 0)).astype("<i4")
    folded = ((columns << 1) ^ (columns >> 31)).astype("<u4")
    return squeeze(np.ascontiguousarray(folded.view(np.uint8).reshape(-1, 4).T).tobytes())


def _read_blocks(head: _Head, rigid: memoryview) -> Blocks | None:
    if not head.block:
        if len(rigid):
            raise DecodeError("motion: has blocks of no size")
        return None
    count = -(-head.splats // head.block)
    shape = (6, count, head.span + 1)
    raw = np.frombuffer(unsqueeze(rigid, 4 * 6 * count * (head.span + 1), "motion: blocks"), np.uint8)
    folded = np.ascontiguousarray(raw.reshape(4, -1).T).view("<u4")[:, 0].astype(np.int64)
    steps = np.where(folded & 1, -((folded + 1) >> 1), folded >> 1).reshape(shape).transpose(2, 1, 0)
    both = np.cumsum(steps, axis=0).astype(np.int32)
    return Blocks(head.block, head.unit, np.ascontiguousarray(both[:, :, :3]), np.ascontiguousarray(both[:, :, 3:]))
