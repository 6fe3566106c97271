"""Chunks of motion for any spans, splats and sizes: what goes in comes out, and the kernel is the definition."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import cags_kernels
from cags_common.bundle.codecs import MotionTile
from cags_common.coding import rans
from cags_common.errors import DecodeError
from cags_common.motion.apply import Looks, MovingTile, Steps, evaluate, move_rows
from cags_common.motion.chunk import (
    DEADZONES,
    FADE_WIDTHS,
    LEVELS,
    MAX_SAMPLES,
    REFINEMENT,
    Chunk,
    ChunkDecoder,
    encode,
)
from cags_common.motion.neighbours import Anchors
from support.anchors import KINDS, any_looks, scattered
from support.examples import examples

native_only = pytest.mark.skipif(not cags_kernels.native_available(), reason="needs the native kernels")
SLOW = [HealthCheck.too_slow, HealthCheck.data_too_large]
QUICK = settings(max_examples=40, deadline=None, suppress_health_check=SLOW)
FEW = settings(max_examples=examples(4), deadline=None, suppress_health_check=SLOW)
"""The definition takes its time over a chunk."""

SIZES = (0.0, 1e-9, 0.3, 3.0, 60.0, 5e3, 1e6, 3e7)


@dataclass
class Case:
    """What a chunk is made of."""

    anchors: Anchors
    moves: Any
    turns: Any
    options: dict[str, Any]

    def encode(self, *, native: bool) -> tuple[bytes, ...]:
        return encode((5, 9), self.anchors, self.moves, self.turns, native=native, **self.options)


def residuals(random: np.random.Generator, shape: tuple[int, int, int], sizes: list[float]) -> np.ndarray:
    """Smooth here, random there, and of any size; some splats not at all."""
    time = np.linspace(0, 3, shape[0])[:, None, None]
    smooth = np.sin(time * random.uniform(0, 2, shape[1:]) + random.uniform(0, 6, shape[1:]))
    rough = random.uniform(-1, 1, shape)
    return np.where(random.random((shape[1], 1)) < 0.3, rough, smooth) * random.choice(sizes, (shape[1], 1))


@st.composite
def cases(draw: st.DrawFn, most: int = 120) -> Case:
    random = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    span, splats = draw(st.integers(1, 64)), draw(st.one_of(st.integers(0, 40), st.integers(0, most)))
    sizes = draw(st.lists(st.sampled_from(SIZES), min_size=1, max_size=3))
    has = draw(st.sampled_from([(True, True), (True, False), (False, True)]))
    parts = [residuals(random, (span + 1, splats, 3 + i), sizes) if has[i] else None for i in range(2)]
    options: dict[str, Any] = {"starts": draw(st.booleans())}
    if draw(st.booleans()):
        options["lives"] = random.integers(0, draw(st.integers(1, span + 2)), splats).astype(np.uint8)
    if draw(st.booleans()):
        centres = random.integers(-(10 ** draw(st.integers(1, 9))), 1000, splats)
        options["fades"] = np.stack([random.integers(0, len(FADE_WIDTHS) + 1, splats), centres], axis=1)
    anchors = any_looks(random, splats, draw(st.sampled_from(KINDS)))
    return Case(anchors, *parts, options)


def decoded(payloads: tuple[bytes, ...], anchors: Anchors, *, native: bool, levels: int = LEVELS) -> Chunk:
    decoder = ChunkDecoder(payloads[0], anchors, native=native)
    for payload in payloads[1:levels]:
        decoder.add_level(payload)
    return decoder.chunk


def same(one: Any, other: Any) -> bool:
    return (one is None and other is None) or np.array_equal(one, other)


@given(cases(40))
@FEW
def test_what_goes_in_comes_out_within_half_a_unit(case: Case) -> None:
    check_round_trip(case, native=False)


@native_only
@given(cases(500))
@QUICK
def test_so_it_does_by_the_kernel(case: Case) -> None:
    check_round_trip(case, native=True)


def check_round_trip(case: Case, *, native: bool) -> None:
    payloads = case.encode(native=native)
    coarse, fine = (decoded(payloads, case.anchors, native=native, levels=levels) for levels in (1, LEVELS))
    unit = REFINEMENT ** (LEVELS - 1)
    for name, wanted in (("moves", case.moves), ("turns", case.turns)):
        for chunk, bound in ((coarse, unit * (0.5 + DEADZONES[0])), (fine, 0.5 + DEADZONES[-1])):
            got = getattr(chunk, name)
            assert (got is None) == (wanted is None)
            if got is not None:
                first = int(not case.options["starts"])
                assert not got[:first].any()
                assert np.abs(got[first:] / 64 - wanted[first:]).max(initial=0) <= bound + 1e-6
    assert same(fine.lives, case.options.get("lives"))
    if "fades" in case.options:
        assert fine.fades is not None
        assert np.array_equal(np.isfinite(fine.fades[:, 1]), case.options["fades"][:, 0] > 0)


@given(cases(40), st.integers(1, LEVELS), st.integers(1, LEVELS))
@FEW
def test_levels_that_say_nothing_are_empty_and_need_not_come(case: Case, moves: int, turns: int) -> None:
    told = {"moves": moves, "turns": turns}
    payloads = replace(case, options=case.options | {"told": (moves, turns)}).encode(native=False)
    count = max(levels for name, levels in told.items() if getattr(case, name) is not None)
    assert [len(payload) > 0 for payload in payloads] == [level < count for level in range(LEVELS)]
    tile = MotionTile(payloads[0], case.anchors)
    for level in range(1, count):
        assert tile.lod == level - 1
        tile.add_layer(level, payloads[level])
    assert tile.lod == LEVELS - 1
    whole = decoded(payloads, case.anchors, native=False)
    assert same(tile.chunk.moves, whole.moves)
    assert same(tile.chunk.turns, whole.turns)
    if count < LEVELS:
        with pytest.raises(DecodeError, match="too much"):
            decoded((*payloads[:count], b"more"), case.anchors, native=False)


@native_only
@given(cases(100))
@FEW
def test_the_kernel_writes_the_definitions_bytes_and_reads_its_samples(case: Case) -> None:
    payloads = case.encode(native=True)
    assert payloads == case.encode(native=False)
    for levels in range(1, LEVELS + 1):
        mine, theirs = (decoded(payloads, case.anchors, native=native, levels=levels) for native in (True, False))
        for name in ("moves", "turns", "lives", "fades"):
            assert same(getattr(mine, name), getattr(theirs, name)), name


@native_only
@given(cases(60), st.integers(0, 2**32 - 1))
@FEW
def test_on_other_looks_than_it_was_encoded_on_a_chunk_is_another_one_and_both_ways_agree(
    case: Case, seed: int
) -> None:
    payloads, random = case.encode(native=True), np.random.default_rng(seed)
    other = any_looks(random, len(case.anchors), str(random.choice(KINDS)))
    mine, theirs = (attempt(payloads, other, native=native) for native in (True, False))
    assert (mine is None) == (theirs is None)
    for name in ("moves", "turns", "lives", "fades"):
        assert mine is None or same(getattr(mine, name), getattr(theirs, name)), name


@native_only
@given(st.integers(1, 32), st.integers(1, 9), st.lists(st.integers(0, 300), max_size=8), st.integers(0, 2**32 - 1))
@QUICK
def test_symbols_by_any_lanes_tables_and_runs(lanes: int, tables: int, runs: list[int], seed: int) -> None:
    random, count = np.random.default_rng(seed), sum(runs)
    which = random.integers(0, tables, count).astype(np.uint8)
    skew = random.uniform(0.02, 1.0, tables)
    symbols = (random.geometric(skew[which]) - 1).clip(0, rans.MAX_SYMBOLS - 1).astype(np.uint8)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rans, "SYMBOLS_A_LANE", max(count // lanes, 1))
        data = rans.encode(which, symbols, np.array(runs, np.int64), native=True)
        assert data == rans.encode(which, symbols, np.array(runs, np.int64), native=False)
    for native in (True, False):
        decoder = rans.decoder(data, native=native)
        for part, wanted in zip(np.split(which, np.cumsum(runs)), np.split(symbols, np.cumsum(runs)), strict=True):
            assert np.array_equal(decoder.take(part), wanted)
        decoder.finish()


def attempt(payloads: tuple[bytes, ...], anchors: Anchors, *, native: bool) -> Chunk | None:
    """The chunk, or None when it is refused as it should be; anything else that is raised is a fault."""
    try:
        return decoded(payloads, anchors, native=native)
    except DecodeError:
        return None


def damaged(payload: bytes, random: np.random.Generator, way: int) -> bytes:
    if way == 0:
        return payload[: random.integers(0, len(payload) + 1)]
    if way == 1:
        return random.integers(0, 256, random.integers(0, 2 * len(payload)), np.uint8).tobytes()
    out = np.frombuffer(payload, np.uint8).copy()
    at = random.integers(0, len(out), random.integers(1, 6))
    out[at] = out[at] ^ (1 << random.integers(0, 8, len(at))) if way == 2 else random.integers(0, 256, len(at))
    return out.tobytes()


@given(cases(40), st.integers(0, 3), st.integers(0, LEVELS - 1), st.integers(0, 2**32 - 1))
@settings(max_examples=examples(60), deadline=None, suppress_health_check=SLOW)
def test_damage_is_refused_or_is_another_chunk_and_both_ways_agree(case: Case, way: int, level: int, seed: int) -> None:
    random = np.random.default_rng(seed)
    payloads = list(case.encode(native=cags_kernels.native_available()))
    payloads[level] = damaged(payloads[level], random, way)
    claimed = int.from_bytes(payloads[0][13:17], "little") if len(payloads[0]) > 16 else 0
    few = claimed * (payloads[0][2] + 1 if claimed else 0) < 20_000
    both = cags_kernels.native_available() and few
    anchors = scattered(claimed, 1) if few and claimed != len(case.anchors) else case.anchors
    chunks = [attempt(tuple(payloads), anchors, native=native) for native in ((True, False) if both else (both,))]
    assert len({chunk is None for chunk in chunks}) == 1
    for chunk in chunks:
        if chunk is None:
            continue
        assert chunk.splats * (chunk.span + 1) <= MAX_SAMPLES
        for name in ("moves", "turns", "lives"):
            assert same(getattr(chunk, name), getattr(chunks[0], name)), name
        if chunk.splats < 2_000:
            check_evaluation(chunk, random)


def looks_of(random: np.random.Generator, count: int) -> Looks:
    quats = random.normal(size=(count, 4)).astype(np.float32)
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    means, logits = random.normal(size=(count, 3)), random.normal(size=count) * 9
    return Looks(means.astype(np.float32), np.where(quats[:, :1] < 0, -quats, quats), logits.astype(np.float32))


def steps_of(random: np.random.Generator, count: int) -> Steps:
    moves, turns = (10.0 ** random.uniform(-9, 3, count) for _ in range(2))
    return Steps(moves.astype(np.float32), turns.astype(np.float32))


def check_evaluation(chunk: Chunk, random: np.random.Generator) -> None:
    """A chunk of any numbers is evaluated without a warning, to unit quaternions, by both ways to the same bits."""
    looks, steps = looks_of(random, chunk.splats), steps_of(random, chunk.splats)
    time = random.uniform(-1, chunk.span + 1)
    moved = evaluate(chunk, time, looks, steps)
    assert np.allclose(np.linalg.norm(moved.quats, axis=1), 1, atol=1e-5)
    if cags_kernels.native_available():
        into = Looks(*(np.zeros_like(a) for a in (looks.means, looks.quats, looks.logit_opacities)))
        rows = np.arange(chunk.splats, dtype=np.int32)
        move_rows([MovingTile(chunk, time, rows, steps)], looks, into, native=True)
        for name in ("means", "quats", "logit_opacities"):
            assert np.array_equal(bits(getattr(into, name)), bits(getattr(moved, name))), name


def bits(array: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(array).view(np.uint32)


@native_only
@given(st.lists(cases(60), min_size=1, max_size=3), st.integers(1, 4), st.data())
@QUICK
def test_tiles_at_a_time_by_the_kernel_are_the_definition_bit_for_bit(
    given_cases: list[Case], threads: int, data: st.DataObject
) -> None:
    random = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    chunks = [decoded(case.encode(native=True), case.anchors, native=True) for case in given_cases]
    ids = random.permutation(sum(chunk.splats for chunk in chunks) + 7).astype(np.int32)
    ends = np.cumsum([chunk.splats for chunk in chunks])
    tiles = []
    for chunk, rows in zip(chunks, np.split(ids, ends), strict=False):
        time = data.draw(st.one_of(st.integers(0, chunk.span).map(float), st.floats(-1, chunk.span + 1)))
        owned = np.where(random.random(chunk.splats) < 0.9, rows, -1).astype(np.int32)
        tiles.append(MovingTile(chunk, time, owned, steps_of(random, chunk.splats)))
    looks = looks_of(random, len(ids))
    ways = []
    for native in (True, False):
        into = Looks(*(np.full_like(a, 9) for a in (looks.means, looks.quats, looks.logit_opacities)))
        move_rows(tiles, looks, into, threads, native=native)
        ways.append(into)
    for name in ("means", "quats", "logit_opacities"):
        assert np.array_equal(bits(getattr(ways[0], name)), bits(getattr(ways[1], name))), name
