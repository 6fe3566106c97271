"""Chunks of motion: what they say comes back within the unit that they say it in."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

import cags_kernels
from cags_common.errors import DecodeError
from cags_common.motion import chunk as chunks
from cags_common.motion.apply import Looks, Steps, evaluate
from cags_common.motion.chunk import Blocks, ChunkDecoder, encode
from cags_common.motion.symbols import _packed, _unpacked

SPAN, SPLATS = 12, 70
FINEST = 0.5 + chunks.DEADZONES[-1]
"""Largest error of the last level, in its unit."""


def wavy(random: np.random.Generator, parts: int, size: float = 40.0) -> np.ndarray:
    time = np.arange(SPAN + 1)[:, None, None]
    return size * np.sin(time / 4 + random.uniform(0, 6, (SPLATS, parts))) * random.normal(size=(SPLATS, parts))


def blocks_of(random: np.random.Generator, size: int = 16) -> Blocks:
    shape = (SPAN + 1, -(-SPLATS // size), 3)
    return Blocks(size, 0.001, *(random.integers(-900, 900, shape).astype(np.int32) for _ in range(2)))


def decoded(payloads: tuple[bytes, ...]) -> chunks.Chunk:
    decoder = ChunkDecoder(payloads[0])
    for payload in payloads[1:]:
        decoder.add_level(payload)
    return decoder.chunk


def test_everything_that_a_chunk_can_say_comes_back() -> None:
    random = np.random.default_rng(3)
    moves, turns, blocks = wavy(random, 3), wavy(random, 4, 8.0), blocks_of(random)
    lives = random.integers(0, SPAN + 2, SPLATS).astype(np.uint8)
    fades = np.stack([random.integers(0, 49, SPLATS), random.integers(-20, 20, SPLATS)], axis=1)
    payloads = encode((7, 3), moves, turns, starts=True, lives=lives, fades=fades, blocks=blocks)
    chunk = decoded(payloads)
    assert chunks.read_looks(payloads[0]) == chunk.looks == (7, 3)
    assert chunk.lives is not None and np.array_equal(chunk.lives, lives)
    assert chunk.blocks is not None and chunk.fades is not None and chunk.moves is not None and chunk.turns is not None
    assert np.array_equal(chunk.blocks.shifts, blocks.shifts) and np.array_equal(chunk.blocks.turns, blocks.turns)
    for part, wanted in ((chunk.moves, moves), (chunk.turns, turns)):
        assert np.abs(part / 64 - wanted).max() <= FINEST + 1 / 64
    width = chunks.FADE_WIDTHS[np.maximum(fades[:, 0], 1) - 1]
    assert np.array_equal(np.isfinite(chunk.fades[:, 1]), fades[:, 0] > 0)
    centre = (lives.astype(float) - 1) / 2 + fades[:, 1] * width / chunks.FADE_STEP
    fading = fades[:, 0] > 0
    assert np.allclose(chunk.fades[fading, 0], centre[fading], rtol=1e-6, atol=1e-6)


def test_the_first_level_alone_is_within_half_of_its_unit_and_the_dead_zone() -> None:
    moves = wavy(np.random.default_rng(4), 3)
    chunk = ChunkDecoder(encode((0, 0), moves, None, starts=True)[0]).chunk
    assert chunk.moves is not None and chunk.turns is None
    unit = chunks.REFINEMENT ** (chunks.LEVELS - 1)
    assert np.abs(chunk.moves / 64 - moves).max() <= unit * (0.5 + chunks.DEADZONES[0]) + unit / 64


def test_without_a_start_the_first_sample_is_nothing() -> None:
    moves = wavy(np.random.default_rng(5), 3)
    chunk = decoded(encode((0, 0), moves, None, starts=False))
    assert chunk.moves is not None and not chunk.moves[0].any()
    assert np.abs(chunk.moves[1:] / 64 - moves[1:]).max() <= FINEST + 1 / 64


@pytest.mark.parametrize("size", [1e-9, 1e6, chunks.MAX_UNITS * 0.999])
def test_motion_of_any_size(size: float) -> None:
    moves = np.clip(wavy(np.random.default_rng(6), 3, 1.0), -1, 1) * size
    chunk = decoded(encode((0, 0), moves, None, starts=True))
    assert chunk.moves is not None and np.abs(chunk.moves / 64 - moves).max() <= FINEST + 1 / 64


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e9])
def test_what_fixed_point_cannot_hold_is_refused(bad: float) -> None:
    moves = np.zeros((3, 2, 3))
    moves[1, 1, 2] = bad
    with pytest.raises(ValueError, match="moves are not finite or beyond"):
        encode((0, 0), moves, None, starts=True)


def test_arrays_that_do_not_fit_are_refused() -> None:
    moves = np.zeros((3, 2, 3))
    with pytest.raises(ValueError, match="one kind for both"):
        encode((0, 0), moves, np.zeros((4, 2, 4)), starts=True)
    with pytest.raises(ValueError, match="one kind for both"):
        encode((0, 0), None, None, starts=True)
    with pytest.raises(ValueError, match="lives"):
        encode((0, 0), moves, None, starts=True, lives=np.array([1, 4], np.uint8))
    with pytest.raises(ValueError, match="fades"):
        encode((0, 0), moves, None, starts=True, fades=np.array([[49, 0], [0, 0]]))
    with pytest.raises(ValueError, match="shifts"):
        encode((0, 0), moves, None, starts=True, blocks=Blocks(1, 1.0, *[np.zeros((3, 1, 3), np.int32)] * 2))
    with pytest.raises(ValueError, match="samples of"):
        encode((0, 0), np.zeros((66, 2, 3)), None, starts=True)


@pytest.mark.parametrize("splats", [0, 1, 2, 31, 32, 33])
def test_a_handful_of_splats_that_end_at_once(splats: int) -> None:
    payloads = encode(
        (0, 0), np.ones((2, splats, 3)), np.ones((2, splats, 4)), starts=False, lives=np.zeros(splats, np.uint8)
    )
    chunk = decoded(payloads)
    assert chunk.moves is not None and (chunk.moves[1] == 64).all() and chunk.moves.shape == (2, splats, 3)


def claim(span: int, splats: int) -> bytes:
    """A payload of a few bytes that is consistent but for its size."""
    payload = bytearray(encode((0, 0), np.zeros((2, 1, 3)), None, starts=True)[0])
    payload[2], payload[12:16] = span, splats.to_bytes(4, "little")
    return bytes(payload)


@pytest.mark.parametrize(("span", "splats"), [(64, 65_536), (16, 65_536), (65, 1), (0, 1), (1, 65_537), (1, 2**32 - 1)])
def test_claims_beyond_bounds_are_refused_before_memory_is_taken(span: int, splats: int) -> None:
    with pytest.raises(DecodeError, match="beyond bounds"):
        ChunkDecoder(claim(span, splats))


def test_levels_come_in_order_and_a_damaged_one_changes_nothing() -> None:
    payloads = encode((0, 0), wavy(np.random.default_rng(8), 3), None, starts=True)
    decoder = ChunkDecoder(payloads[0])
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
    still = np.zeros((samples, splats, 1))
    blocks = Blocks(1, 1.0, *[np.zeros((samples, splats, 3), np.int32)] * 2)
    payloads = encode((0, 0), still.repeat(3, 2), still.repeat(4, 2), starts=True, blocks=blocks)
    assert sum(map(len, payloads)) < 100_000
    tracemalloc.start()
    try:
        decoded(payloads)
        assert tracemalloc.get_traced_memory()[1] < 160 << 20
    finally:
        tracemalloc.stop()


def test_halved_units_move_half_as_far() -> None:
    moves = np.arange(15, dtype=np.float64).reshape(5, 1, 3)
    looks = Looks(np.zeros((1, 3), np.float32), np.float32([[1, 0, 0, 0]]), np.zeros(1, np.float32))
    steps = Steps(np.float32([0.5]), np.float32([0.5]))
    chunks_ = [decoded(encode((0, 0), moves, None, starts=True, finer=(finer, 0))) for finer in (0, 1)]
    shown = [evaluate(chunk, 4.0, looks, steps).means for chunk in chunks_]
    assert np.array_equal(shown[1] * 2, shown[0]) and shown[0].any()


def test_units_are_halved_within_bounds_alone() -> None:
    moves = np.zeros((2, 1, 3))
    with pytest.raises(ValueError, match=r"halved \(11, 0\) times"):
        encode((0, 0), moves, None, starts=True, finer=(11, 0))
    payload = bytearray(encode((0, 0), moves, None, starts=True)[0])
    payload[18] = 11
    with pytest.raises(DecodeError, match="beyond bounds"):
        ChunkDecoder(bytes(payload))


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
    payloads = encode((0, 0), moves, None, starts=True)
    alone = encode((0, 0), moves[:, ~still], None, starts=True)
    assert sum(map(len, payloads)) - sum(map(len, alone)) < 80
    decoder = ChunkDecoder(payloads[0])
    for payload in payloads[1:]:
        decoder.add_level(payload)
    assert decoder.chunk.moves is not None
    assert not decoder.chunk.moves[:, still].any()
    assert np.abs(decoder.chunk.moves[:, ~still] / 64 - moves[:, ~still]).max() <= 0.65 + 1 / 64


def test_a_list_of_movers_that_nobody_announced_is_refused() -> None:
    moves = np.zeros((3, 600, 3))
    moves[:, ::7] = 9.0
    payload = bytearray(encode((0, 0), moves, None, starts=True)[0])
    payload[1] &= ~chunks.STILLS
    with pytest.raises(DecodeError, match="who moves"):
        ChunkDecoder(bytes(payload))


@pytest.mark.parametrize("span", [1, 2, 3, 7, SPAN, 16, 64])
@pytest.mark.parametrize("starts", [False, True])
def test_curved_chunks_say_the_same_within_the_same_units(span: int, starts: bool) -> None:
    random = np.random.default_rng(8)
    moves, turns = (np.cumsum(random.normal(size=(span + 1, 9, parts)), axis=0) * 20 for parts in (3, 4))
    chunk = decoded(encode((0, 0), moves, turns, starts=starts, curved=(True, True)))
    for part, wanted in ((chunk.moves, moves), (chunk.turns, turns)):
        assert part is not None and chunk.curved == (True, True)
        assert np.abs(part / 64 - wanted)[0 if starts else 1 :].max() <= FINEST + 1 / 64


def test_what_moves_smoothly_takes_fewer_bytes_against_curves() -> None:
    time = np.linspace(0, 2, 17)[:, None, None]
    moves = 300 * np.sin(time + np.random.default_rng(9).uniform(0, 6, (SPLATS, 3)))
    straight, curved = (
        sum(map(len, encode((0, 0), moves, None, starts=True, curved=(c, False)))) for c in (False, True)
    )
    assert curved < 0.8 * straight


@pytest.mark.skipif(not cags_kernels.native_available(), reason="compares the kernel with numpy")
@pytest.mark.parametrize("size", [1.0, 1e3, chunks.MAX_UNITS / 2])
def test_curved_chunks_are_the_same_in_numpy_and_the_kernel(size: float) -> None:
    random = np.random.default_rng(10)
    for span in (*range(1, 20), 63, 64):
        moves = random.uniform(-size, size, (span + 1, 5, 3))
        made = [
            encode((0, 0), moves, None, starts=True, curved=(True, False), native=native) for native in (False, True)
        ]
        assert made[0] == made[1]
        decoders = [ChunkDecoder(made[0][0], native=native) for native in (False, True)]
        for payload in made[0][1:]:
            for decoder in decoders:
                decoder.add_level(payload)
        assert np.array_equal(*(decoder.chunk.moves for decoder in decoders))


@pytest.mark.parametrize("flag", [chunks.CURVED_MOVES, chunks.CURVED_TURNS])
def test_a_curve_of_what_is_not_told_is_refused(flag: int) -> None:
    payload = bytearray(encode((0, 0), None, np.zeros((3, 2, 4)), starts=True)[0])
    payload[1] = payload[1] & ~chunks.TURNS | flag
    with pytest.raises(DecodeError, match="flags"):
        ChunkDecoder(bytes(payload))


def test_what_is_spent_on_each_part_adds_up_to_the_payloads() -> None:
    random = np.random.default_rng(11)
    lives = random.integers(0, SPAN + 2, SPLATS).astype(np.uint8)
    fades = np.stack([random.integers(0, 49, SPLATS), random.integers(-20, 20, SPLATS)], axis=1)
    sides = {"lives": lives, "fades": fades, "blocks": blocks_of(random)}
    payloads = encode((7, 3), wavy(random, 3, 4e5), wavy(random, 4), starts=True, curved=(True, False), **sides)
    found = chunks.spent(payloads)
    assert sum(found.values()) == sum(map(len, payloads)) and min(found.values()) >= 0
    named = (
        "heads and tables",
        "blocks",
        "large numbers",
        "lives",
        "fades",
        "positions, level 0",
        "rotations, level 2",
    )
    assert all(found[name] > 0 for name in named)
    assert chunks.spent(payloads[:1])["positions, level 0"] == found["positions, level 0"]
