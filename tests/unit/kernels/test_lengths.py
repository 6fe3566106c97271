"""The codec's and motion's entries: each length that crosses the interface is checked on the library's side."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from cags_common.coding import rans
from cags_common.motion.contexts import runs
from cags_common.motion.knots import knots
from cags_common.motion.neighbours import Neighbours
from cags_common.motion.symbols import Samples, Tree
from cags_kernels import codec, library, motion, native_available
from support.anchors import scattered

pytestmark = pytest.mark.skipif(not native_available(), reason="the native library is not built")

SPAN, SPLATS = 4, 5
Change = Callable[[int], None]


def changes(arguments: tuple[Any, ...]) -> Iterator[tuple[str, Change]]:
    """Every length among the arguments of a call by its name, with what adds to it."""
    for at, argument in enumerate(arguments):
        given = getattr(argument, "_obj", argument)
        if isinstance(given, ctypes.Array) and issubclass(given._type_, ctypes.Structure):
            for index, structure in enumerate(given):
                yield from ((f"{name} of {index}", add) for name, add in of_structure(structure))
        elif isinstance(given, ctypes.Structure):
            yield from of_structure(given)
        elif isinstance(argument, ctypes.c_int64) and isinstance(arguments[at - 1], ctypes.c_void_p):
            yield f"argument {at}", lambda more, given=given: setattr(given, "value", given.value + more)


def of_structure(given: ctypes.Structure) -> Iterator[tuple[str, Change]]:
    for name, *_ in given._fields_:
        if not name.endswith(("lengths", "_length", "_bytes")) or name == "run_lengths":
            continue
        held = getattr(given, name)
        if isinstance(held, ctypes.Array):
            for index in range(len(held)):
                yield f"{name}[{index}]", lambda more, held=held, i=index: held.__setitem__(i, held[i] + more)
        else:
            yield name, lambda more, name=name: setattr(given, name, getattr(given, name) + more)


class Probe:
    """The library; before a call of ``entry`` it makes the same with each length wrong, and notes what is not refused.

    Those of ``open_ended`` are tried only too short.
    """

    def __init__(self, entry: str, open_ended: tuple[str, ...]) -> None:
        self.entry, self.open_ended = entry, open_ended
        self.tried: list[str] = []
        self.taken: list[str] = []

    def __getattr__(self, name: str) -> Any:
        true = getattr(library.library(), name)
        return self.probing(true) if name == self.entry else true

    def probing(self, true: Any) -> Callable[..., int]:
        def call(*arguments: Any) -> int:
            for length, add in changes(arguments):
                self.tried.append(length)
                for more in (-1,) if length in self.open_ended else (-1, 1):
                    add(more)
                    if true(*arguments) == 0:
                        self.taken.append(f"{length} {more:+}")
                    add(-more)
            return int(true(*arguments))

        return call


def dequantise() -> np.ndarray:
    tables = np.zeros((4, 4), np.float32), np.zeros((2, 3), np.float32)
    leaves = np.ones((2, 3), np.float32)
    attributes = [
        codec.CodecAttribute(np.array([1], np.uint8), tables[0], None, None, 0, "quats", 0).structure(),
        codec.CodecAttribute(np.array([1], np.uint8), tables[1], leaves, leaves, 1, "sh0", 0).structure(),
    ]
    widths = {"quats": (4,), "log_scales": (3,), "logit_opacities": (), "sh0": (3,), "sh_rest": (3, 3)}
    columns = {name: np.zeros((4, *shape), np.float32) for name, shape in widths.items()}
    before = np.ones((2, 4), np.uint32)
    return codec.dequantise(attributes, b"\x0f\x0f", before, columns, rodrigues=False)


NEAR = np.array([[-1, -1], [0, -1], [0, 1]], np.int32)
LIKELY = codec.Symbols(np.array([1, 0, 1], np.uint8), NEAR, np.full((18, 4), 1024, np.uint16), 2, 1)
CODES = np.array([3, 0, 2], np.uint8)


def near_ones() -> Any:
    return codec.nearest(np.arange(9, dtype=np.float32).reshape(3, 3))


def encode_codes() -> Any:
    return codec.encode(LIKELY, CODES, 1)


def decode_codes() -> Any:
    states, words = codec.encode(LIKELY, CODES, 1)
    codes, _ = codec.decode(LIKELY, states.tobytes() + words.tobytes(), 1)
    assert codes.tolist() == CODES.tolist()
    return codes


def positions() -> np.ndarray:
    return codec.positions(np.ones((4, 3), np.float32), np.ones(3), 0.5)


TABLES, SYMBOLS = np.zeros(6, np.uint8), np.arange(6, dtype=np.uint8)
RUNS = np.array([6])


def encode_symbols() -> tuple[np.ndarray, np.ndarray]:
    shares = np.ones((1, 256), np.uint32), np.arange(256, dtype=np.uint32)[None]
    return motion.encode_symbols(TABLES, SYMBOLS, RUNS, 1, shares)


def take() -> np.ndarray:
    return motion.SymbolDecoder(rans.encode(TABLES, SYMBOLS, RUNS)).take(TABLES)


def neighbours() -> tuple[np.ndarray, np.ndarray]:
    looks = scattered(SPLATS)
    return motion.neighbours(looks.positions, looks.moves)


def untold() -> Samples:
    anchors = scattered(SPLATS)
    tree = Tree.of(knots(SPAN, start=True), anchors, Neighbours.of(anchors), turn=False)
    return Samples.untold(tree, SPAN)


def encode_tree() -> tuple[np.ndarray, ...]:
    samples = untold()
    wanted = (np.arange(samples.values.size, dtype=np.float64) * 89 % 61).reshape(samples.values.shape)
    coded = motion.encode_tree(samples.kernel(4), wanted, samples.values, samples.told, 0.0)
    return *coded, samples.values, samples.told


def decode_tree() -> tuple[np.ndarray, np.ndarray]:
    tables, symbols, escapes, *_ = encode_tree()
    assert not escapes.size
    samples = untold()
    order = samples.tree.order
    decoder = motion.SymbolDecoder(rans.encode(tables, symbols, np.tile([1, *runs(SPLATS, 3)], len(order))))
    assert decoder.tree(samples.kernel(4), samples.values, samples.told, escapes, 0) == 0
    return samples.values, samples.told


def move_rows() -> np.ndarray:
    steps, row = np.ones(SPLATS, np.float32), np.arange(SPLATS, dtype=np.int32)
    moves, turns = (np.ones((SPAN + 1, SPLATS, parts), np.int32) for parts in (3, 4))
    lives, fades = np.full(SPLATS, 3, np.uint8), np.ones((SPLATS, 2), np.float32)
    tile = motion.TileMotion(SPLATS, SPAN, 1.0, 1, 0.0, row, moves, turns, steps, steps, lives, fades)
    looks, into = ([np.ones((SPLATS, *shape), np.float32) for shape in ((3,), (4,), ())] for _ in range(2))
    motion.move_rows([tile], tuple(looks), tuple(into), 1)
    return np.concatenate([array.ravel() for array in into])


ENTRIES: dict[str, tuple[Callable[[], Any], int, tuple[str, ...]]] = {
    "cags_codec_dequantise": (dequantise, 16, ("lengths[1] of 0", "lengths[1] of 1")),
    "cags_codec_positions": (positions, 2, ()),
    "cags_codec_nearest": (near_ones, 2, ()),
    "cags_codec_encode": (encode_codes, 6, ()),
    "cags_codec_decode": (decode_codes, 5, ()),
    "cags_symbols_count": (lambda: motion.count_symbols(TABLES, SYMBOLS), 3, ()),
    "cags_symbols_encode": (encode_symbols, 7, ("lengths[2]", "lengths[3]", "lengths[4]", "lengths[5]")),
    "cags_symbols_open": (take, 2, ()),
    "cags_symbols_take": (take, 2, ()),
    "cags_motion_neighbours": (neighbours, 4, ()),
    "cags_motion_decode_tree": (decode_tree, 7, ("argument 3",)),
    "cags_motion_encode_tree": (encode_tree, 10, ()),
    "cags_motion_rows": (move_rows, 13, ()),
}
"""What calls it; how many lengths it takes; those of arrays that may be longer: tables beyond the codes, runs and
lanes, of which there may be any number, and escapes that are left over."""


@pytest.mark.parametrize("entry", ENTRIES)
def test_every_wrong_length_is_refused_and_changes_nothing(monkeypatch: pytest.MonkeyPatch, entry: str) -> None:
    call, lengths, open_ended = ENTRIES[entry]
    wanted, probe = call(), Probe(entry, open_ended)
    for module in (codec, motion):
        monkeypatch.setattr(module, "library", lambda: probe)
    got = call()
    assert len(probe.tried) == lengths
    assert not probe.taken
    for before, after in zip(wanted, got, strict=True):
        np.testing.assert_array_equal(before, after)
