"""Chunks of motion: what they say comes back within the unit that they say it in."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

import cags_kernels
from cags_common.errors import DecodeError
from cags_common.motion import chunk as chunks
from cags_common.motion.apply import Looks, Steps, evaluate
from cags_common.motion.chunk import ChunkDecoder, encode
from cags_common.motion.neighbours import Anchors
from cags_common.motion.symbols import _packed, _unpacked
from cags_common.tiles.morton import morton_order
from support.anchors import scattered, together

SPAN, SPLATS = 12, 70
LOOKS = scattered(SPLATS)
FINEST = 0.5 + chunks.DEADZONES[-1]
"""Largest error of the last level, in its unit."""


def wavy(random: np.random.Generator, parts: int, size: float = 40.0) -> np.ndarray:
    time = np.arange(SPAN + 1)[:, None, None]
    return size * np.sin(time / 4 + random.uniform(0, 6, (SPLATS, parts))) * random.normal(size=(SPLATS, parts))


def decoded(payloads: tuple[bytes, ...], anchors: Anchors = LOOKS) -> chunks.Chunk:
    decoder = ChunkDecoder(payloads[0], anchors)
    for payload in payloads[1:]:
        decoder.add_level(payload)
    return decoder.chunk


def test_everything_that_a_chunk_can_say_comes_back() -> None:
    random = np.random.default_rng(3)
    moves, turns = wavy(random, 3), wavy(random, 4, 8.0)
    lives = random.integers(0, SPAN + 2, SPLATS).astype(np.uint8)
    fades = np.stack([random.integers(0, 49, SPLATS), random.integers(-20, 20, SPLATS)], axis=1)
    payloads = encode((7, 3), LOOKS, moves, turns, starts=True, lives=lives, fades=fades)
    chunk = decoded(payloads)
    assert chunks.read_looks(payloads[0]) == chunk.looks == (7, 3)
    assert chunk.lives is not None and np.array_equal(chunk.lives, lives)
    assert chunk.fades is not None and chunk.moves is not None and chunk.turns is not None
    for part, wanted in ((chunk.moves, moves), (chunk.turns, turns)):
        assert np.abs(part / 64 - wanted).max() <= FINEST + 1 / 64
    width = chunks.FADE_WIDTHS[np.maximum(fades[:, 0], 1) - 1]
    assert np.array_equal(np.isfinite(chunk.fades[:, 1]), fades[:, 0] > 0)
    centre = (lives.astype(float) - 1) / 2 + fades[:, 1] * width / chunks.FADE_STEP
    fading = fades[:, 0] > 0
    assert np.allclose(chunk.fades[fading, 0], centre[fading], rtol=1e-6, atol=1e-6)


def test_the_first_level_alone_is_within_half_of_its_unit_and_the_dead_zone() -> None:
    moves = wavy(np.random.default_rng(4), 3)
    chunk = ChunkDecoder(encode((0, 0), LOOKS, moves, None, starts=True)[0], LOOKS).chunk
    assert chunk.moves is not None and chunk.turns is None
    unit = chunks.REFINEMENT ** (chunks.LEVELS - 1)
    assert np.abs(chunk.moves / 64 - moves).max() <= unit * (0.5 + chunks.DEADZONES[0]) + unit / 64


def test_without_a_start_the_first_sample_is_nothing() -> None:
    moves = wavy(np.random.default_rng(5), 3)
    chunk = decoded(encode((0, 0), LOOKS, moves, None, starts=False))
    assert chunk.moves is not None and not chunk.moves[0].any()
    assert np.abs(chunk.moves[1:] / 64 - moves[1:]).max() <= FINEST + 1 / 64


@pytest.mark.parametrize("size", [1e-9, 1e6, chunks.MAX_UNITS * 0.999])
def test_motion_of_any_size(size: float) -> None:
    moves = np.clip(wavy(np.random.default_rng(6), 3, 1.0), -1, 1) * size
    chunk = decoded(encode((0, 0), LOOKS, moves, None, starts=True))
    assert chunk.moves is not None and np.abs(chunk.moves / 64 - moves).max() <= FINEST + 1 / 64


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e9])
def test_what_fixed_point_cannot_hold_is_refused(bad: float) -> None:
    moves = np.zeros((3, 2, 3))
    moves[1, 1, 2] = bad
    with pytest.raises(ValueError, match="moves are not finite or beyond"):
        encode((0, 0), together(2), moves, None, starts=True)


def test_arrays_that_do_not_fit_are_refused() -> None:
    moves, two = np.zeros((3, 2, 3)), together(2)
    with pytest.raises(ValueError, match="one kind for both"):
        encode((0, 0), two, moves, np.zeros((4, 2, 4)), starts=True)
    with pytest.raises(ValueError, match="one kind for both"):
        encode((0, 0), two, None, None, starts=True)
    with pytest.raises(ValueError, match="lives"):
        encode((0, 0), two, moves, None, starts=True, lives=np.array([1, 4], np.uint8))
    with pytest.raises(ValueError, match="fades"):
        encode((0, 0), two, moves, None, starts=True, fades=np.array([[49, 0], [0, 0]]))
    with pytest.raises(ValueError, match="2 splats move, and the looks have 3"):
        encode((0, 0), together(3), moves, None, starts=True)
    with pytest.raises(ValueError, match="motion: positions or units of the looks are not finite"):
        encode((0, 0), replace(two, positions=np.full((2, 3), np.nan, np.float32)), moves, None, starts=True)
    with pytest.raises(ValueError, match="samples of"):
        encode((0, 0), two, np.zeros((66, 2, 3)), None, starts=True)


@pytest.mark.parametrize("splats", [0, 1, 2, 31, 32, 33])
def test_a_handful_of_splats_that_end_at_once(splats: int) -> None:
    moves, turns, anchors = np.ones((2, splats, 3)), np.ones((2, splats, 4)), together(splats)
    payloads = encode((0, 0), anchors, moves, turns, starts=False, lives=np.zeros(splats, np.uint8))
    chunk = decoded(payloads, anchors)
    assert chunk.moves is not None and (chunk.moves[1] == 64).all() and chunk.moves.shape == (2, splats, 3)


def claim(span: int, splats: int) -> bytes:
    """A payload of a few bytes that is consistent but for its size."""
    payload = bytearray(encode((0, 0), together(1), np.zeros((2, 1, 3)), None, starts=True)[0])
    payload[2], payload[13:17] = span, splats.to_bytes(4, "little")
    return bytes(payload)


@pytest.mark.parametrize(("span", "splats"), [(64, 65_536), (16, 65_536), (65, 1), (0, 1), (1, 65_537), (1, 2**32 - 1)])
def test_claims_beyond_bounds_are_refused_before_memory_is_taken(span: int, splats: int) -> None:
    with pytest.raises(DecodeError, match="beyond bounds"):
        ChunkDecoder(claim(span, splats), together(1))


def test_levels_come_in_order_and_a_damaged_one_changes_nothing() -> None:
    payloads = encode((0, 0), LOOKS, wavy(np.random.default_rng(8), 3), None, starts=True)
    decoder = ChunkDecoder(payloads[0], LOOKS)
    assert decoder.chunk.moves is not None
    before = decoder.chunk.moves.copy()
    for damaged in (payloads[1][:-2], b"", payloads[1][:3], b"\xff" * 40):
        with pytest.raises(DecodeError):
            decoder.add_level(damaged)
        assert np.array_equal(decoder.chunk.moves, before) and decoder.levels == 1
    for payload in payloads[1:]:
        decoder.add_level(payload)
    with pytest.raises(DecodeError, match="too much"):
        decoder.add_level(payloads[-1])


@pytest.mark.skipif(not cags_kernels.native_available(), reason="the definition takes a minute over it")
def test_the_largest_claim_of_a_few_bytes_takes_bounded_memory() -> None:
    samples, splats = 16, chunks.MAX_SAMPLES // 16
    still, anchors = np.zeros((samples, splats, 1)), scattered(splats)
    payloads = encode((0, 0), anchors, still.repeat(3, 2), still.repeat(4, 2), starts=True)
    assert sum(map(len, payloads)) < 100_000
    tracemalloc.start()
    try:
        decoded(payloads, anchors)
        assert tracemalloc.get_traced_memory()[1] < 160 << 20
    finally:
        tracemalloc.stop()


def test_halved_units_move_half_as_far() -> None:
    moves = np.arange(15, dtype=np.float64).reshape(5, 1, 3)
    looks = Looks(np.zeros((1, 3), np.float32), np.float32([[1, 0, 0, 0]]), np.zeros(1, np.float32))
    steps = Steps(np.float32([0.5]), np.float32([0.5]))
    one = together(1)
    chunks_ = [decoded(encode((0, 0), one, moves, None, starts=True, finer=(finer, 0)), one) for finer in (0, 1)]
    shown = [evaluate(chunk, 4.0, looks, steps).means for chunk in chunks_]
    assert np.array_equal(shown[1] * 2, shown[0]) and shown[0].any()


def test_units_are_halved_within_bounds_alone() -> None:
    moves, one = np.zeros((2, 1, 3)), together(1)
    with pytest.raises(ValueError, match=r"halved \(11, 0\) times"):
        encode((0, 0), one, moves, None, starts=True, finer=(11, 0))
    for at in (17, 18):
        payload = bytearray(encode((0, 0), one, moves, None, starts=True)[0])
        payload[at] = 11
        with pytest.raises(DecodeError, match="beyond bounds"):
            ChunkDecoder(bytes(payload), one)


@pytest.mark.parametrize("cut", [1, 4, 20, 40])
def test_large_residuals_that_are_cut_short_are_refused(cut: int) -> None:
    data = _packed(np.array([1 << 20, -(1 << 22), 300, -127], np.int32))
    assert _unpacked(memoryview(data)).tolist() == [1 << 20, -(1 << 22), 300, -127]
    with pytest.raises(DecodeError):
        _unpacked(memoryview(data[: max(len(data) - cut, 1)]))


def test_splats_that_keep_their_places_take_next_to_nothing_and_change_nothing() -> None:
    random = np.random.default_rng(3)
    moves = np.cumsum(random.integers(-20, 21, (9, 400, 3)), axis=0).astype(float)
    still = np.arange(400) % 4 != 0
    moves[:, still] *= 1e-3
    anchors = scattered(400)
    payloads = encode((0, 0), anchors, moves, None, starts=True)
    alone = encode((0, 0), anchors.take(~still), moves[:, ~still], None, starts=True)
    assert sum(map(len, payloads)) - sum(map(len, alone)) < 80
    chunk, others = decoded(payloads, anchors), decoded(alone, anchors.take(~still))
    assert chunk.moves is not None and others.moves is not None
    assert not chunk.moves[:, still].any()
    assert np.array_equal(chunk.moves[:, ~still], others.moves), "neighbours are those that move"
    assert np.abs(chunk.moves[:, ~still] / 64 - moves[:, ~still]).max() <= 0.65 + 1 / 64


def test_a_list_of_movers_that_nobody_announced_is_refused() -> None:
    moves = np.zeros((3, 600, 3))
    moves[:, ::7] = 9.0
    payload = bytearray(encode((0, 0), together(600), moves, None, starts=True)[0])
    payload[1] &= ~chunks.STILLS
    with pytest.raises(DecodeError, match="who moves"):
        ChunkDecoder(bytes(payload), together(600))


@pytest.mark.parametrize("span", [1, 2, 3, 7, SPAN, 16, 64])
@pytest.mark.parametrize("starts", [False, True])
def test_curved_chunks_say_the_same_within_the_same_units(span: int, starts: bool) -> None:
    random = np.random.default_rng(8)
    moves, turns = (np.cumsum(random.normal(size=(span + 1, 9, parts)), axis=0) * 20 for parts in (3, 4))
    nine = scattered(9)
    chunk = decoded(encode((0, 0), nine, moves, turns, starts=starts, curved=(True, True)), nine)
    for part, wanted in ((chunk.moves, moves), (chunk.turns, turns)):
        assert part is not None and chunk.curved == (True, True)
        assert np.abs(part / 64 - wanted)[0 if starts else 1 :].max() <= FINEST + 1 / 64


def test_what_moves_smoothly_takes_fewer_bytes_against_curves() -> None:
    time = np.linspace(0, 2, 17)[:, None, None]
    moves = 300 * np.sin(time + np.random.default_rng(9).uniform(0, 6, (SPLATS, 3)))
    straight, curved = (
        sum(map(len, encode((0, 0), LOOKS, moves, None, starts=True, curved=(c, False)))) for c in (False, True)
    )
    assert curved < 0.8 * straight


@pytest.mark.skipif(not cags_kernels.native_available(), reason="compares the kernel with numpy")
@pytest.mark.parametrize("size", [1.0, 1e3, chunks.MAX_UNITS / 2])
def test_curved_chunks_are_the_same_in_numpy_and_the_kernel(size: float) -> None:
    random = np.random.default_rng(10)
    for span in (*range(1, 20), 63, 64):
        moves, five = random.uniform(-size, size, (span + 1, 5, 3)), scattered(5, span)
        made = [
            encode((0, 0), five, moves, None, starts=True, curved=(True, False), native=native)
            for native in (False, True)
        ]
        assert made[0] == made[1]
        decoders = [ChunkDecoder(made[0][0], five, native=native) for native in (False, True)]
        for payload in made[0][1:]:
            for decoder in decoders:
                decoder.add_level(payload)
        assert np.array_equal(*(decoder.chunk.moves for decoder in decoders))


@pytest.mark.parametrize(("flag", "levels"), [(chunks.CURVED_MOVES, 3), (chunks.CURVED_TURNS, 4)])
def test_a_curve_of_what_is_not_told_is_refused(flag: int, levels: int) -> None:
    payload = bytearray(encode((0, 0), together(2), np.zeros((3, 2, 3)), np.zeros((3, 2, 4)), starts=True)[0])
    payload[1] |= flag
    ChunkDecoder(bytes(payload), together(2))
    payload[levels] = 0
    with pytest.raises(DecodeError, match="flags"):
        ChunkDecoder(bytes(payload), together(2))


@pytest.mark.parametrize(
    ("at", "value"), [(0, 9), (0, 12), (1, 64 | chunks.STARTS), (1, 128), (3, 5), (4, 5), (3, 255), (4, 255)]
)
def test_other_versions_unknown_flags_and_more_levels_are_refused(at: int, value: int) -> None:
    payload = bytearray(encode((0, 0), together(2), np.zeros((3, 2, 3)), np.zeros((3, 2, 4)), starts=True)[0])
    payload[at] = value
    for read in (lambda data: ChunkDecoder(data, together(2)), chunks.read_looks):
        with pytest.raises(DecodeError, match="this program reads 11"):
            read(bytes(payload))


def test_the_head_is_laid_out_as_documented() -> None:
    moves, turns = (np.full((SPAN + 1, SPLATS, parts), 50.0) for parts in (3, 4))
    curved, told = (False, True), (3, 2)
    first, *_ = encode((300, 70_000), LOOKS, moves, turns, starts=True, finer=(2, 1), told=told, curved=curved)
    assert first[:5] == bytes([11, chunks.STARTS | chunks.CURVED_TURNS, SPAN, *told])
    numbers = [int.from_bytes(first[at : at + 4], "little") for at in (5, 9, 13, 19, 23, 27)]
    assert numbers[:3] == [300, 70_000, SPLATS] and first[17:19] == bytes([2, 1])
    assert sum(numbers[3:]) == len(first) - 31


@pytest.mark.parametrize("native", [False, True] if cags_kernels.native_available() else [False])
@pytest.mark.parametrize("parts", ["moves", "turns", "neither"])
def test_what_no_level_tells_is_not_there(parts: str, native: bool) -> None:
    moves, turns = wavy(np.random.default_rng(12), 3), wavy(np.random.default_rng(13), 4)
    told = {"moves": (2, 0), "turns": (0, 2), "neither": (0, 0)}[parts]
    lives = np.full(SPLATS, 2, np.uint8)
    payloads = encode((0, 0), LOOKS, moves, turns, starts=True, told=told, lives=lives, curved=(True, True))
    assert [bool(payload) for payload in payloads] == [True, parts != "neither", False, False]
    decoder = ChunkDecoder(payloads[0], LOOKS, native=native)
    for payload in payloads[1:]:
        decoder.add_level(payload)
    chunk = decoder.chunk
    assert [chunk.moves is not None, chunk.turns is not None] == [parts == "moves", parts == "turns"]
    assert chunk.curved == (parts == "moves", parts == "turns")
    assert chunk.lives is not None and np.array_equal(chunk.lives, lives)
    assert decoder.levels == chunks.LEVELS


@pytest.mark.parametrize("count", [0, SPLATS - 1, SPLATS + 1])
def test_a_chunk_of_another_number_of_splats_than_its_looks_is_refused(count: int) -> None:
    payloads = encode((0, 0), LOOKS, wavy(np.random.default_rng(14), 3), None, starts=True)
    message = f"^motion: {SPLATS} splats move, and the looks have {count}$"
    for read in (lambda anchors: ChunkDecoder(payloads[0], anchors), lambda anchors: chunks.spent(payloads, anchors)):
        with pytest.raises(DecodeError, match=message):
            read(scattered(count))


@pytest.mark.parametrize("column", ["positions", "moves", "turns"])
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_looks_that_are_not_finite_are_refused(column: str, bad: float) -> None:
    payloads = encode((0, 0), LOOKS, wavy(np.random.default_rng(14), 3), None, starts=True)
    damaged = getattr(LOOKS, column).copy()
    damaged.reshape(-1)[7] = bad
    with pytest.raises(DecodeError, match=r"^motion: positions or units of the looks are not finite$"):
        ChunkDecoder(payloads[0], replace(LOOKS, **{column: damaged}))


UNIT = 5e-3


def rotating(positions: np.ndarray) -> np.ndarray:
    """Where splats are that turn by a third of a circle about an axis, less where they were, in units."""
    angles = np.linspace(0, 2, SPAN + 1)[:, None]
    x, y, z = positions.astype(np.float64).T
    cos, sin = np.cos(angles), np.sin(angles)
    return np.stack([cos * x - sin * y - x, sin * x + cos * y - y, np.zeros_like(angles * z)], axis=2) / UNIT


def test_what_turns_as_one_takes_far_fewer_bytes_than_the_same_residuals_elsewhere() -> None:
    random, count = np.random.default_rng(15), 2000
    ball = random.normal(size=(count, 3))
    ball /= np.linalg.norm(ball, axis=1, keepdims=True)
    places = ball[morton_order(ball.astype(np.float32))].astype(np.float32)
    unit = np.full(count, UNIT, np.float32)
    moves = rotating(places)
    cluster, shuffled = (
        encode((0, 0), Anchors(positions, unit, unit), moves, None, starts=False)
        for positions in (places, random.permutation(places))
    )
    assert sum(map(len, cluster)) < 0.5 * sum(map(len, shuffled))
    chunk = decoded(cluster, Anchors(places, unit, unit))
    assert chunk.moves is not None and np.abs(chunk.moves / 64 - moves).max() <= FINEST + 1 / 64


def test_what_further_levels_need_is_kept_until_the_last_one() -> None:
    moves = wavy(np.random.default_rng(11), 3)
    payloads = encode((0, 0), LOOKS, moves, None, starts=True)
    decoder, kept = ChunkDecoder(payloads[0], LOOKS), []
    for payload in payloads[1:]:
        kept.append(decoder.nbytes)
        decoder.add_level(payload)
    assert min(kept) > moves.size * 5
    assert decoder.nbytes == 0
    with pytest.raises(DecodeError, match="too much"):
        decoder.add_level(payloads[-1])


def test_a_fork_does_not_change_what_it_was_copied_from() -> None:
    payloads = encode((0, 0), LOOKS, wavy(random := np.random.default_rng(16), 3), wavy(random, 4), starts=True)
    one = ChunkDecoder(payloads[0], LOOKS)
    before = one.chunk
    assert before.moves is not None and before.turns is not None
    kept = before.moves.copy(), before.turns.copy()
    fork = one.fork()
    for payload in payloads[1:]:
        fork.add_level(payload)
    for chunk in (before, one.chunk):
        assert np.array_equal(chunk.moves, kept[0]) and np.array_equal(chunk.turns, kept[1])
    for payload in payloads[1:]:
        one.add_level(payload)
    assert np.array_equal(one.chunk.moves, fork.chunk.moves) and np.array_equal(one.chunk.turns, fork.chunk.turns)


def test_what_is_spent_on_each_part_adds_up_to_the_payloads() -> None:
    random = np.random.default_rng(11)
    lives = random.integers(0, SPAN + 2, SPLATS).astype(np.uint8)
    fades = np.stack([random.integers(0, 49, SPLATS), random.integers(-20, 20, SPLATS)], axis=1)
    sides = {"lives": lives, "fades": fades}
    moves, turns = wavy(random, 3, 4e5), wavy(random, 4)
    payloads = encode((7, 3), LOOKS, moves, turns, starts=True, curved=(True, False), **sides)
    found = chunks.spent(payloads, LOOKS)
    assert sum(found.values()) == sum(map(len, payloads)) and min(found.values()) >= 0
    named = (
        "heads and tables",
        "large numbers",
        "lives",
        "fades",
        "positions, level 0",
        "rotations, level 2",
    )
    assert all(found[name] > 0 for name in named)
    assert chunks.spent(payloads[:1], LOOKS)["positions, level 0"] == found["positions, level 0"]
