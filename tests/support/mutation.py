"""Seeded damage to files: what transfers, disks and hostile senders do to them."""

from __future__ import annotations

import numpy as np

NUMBERS = (
    b"0",
    b"1",
    b"-1",
    b"255",
    b"256",
    b"65536",
    b"2147483648",
    b"4294967295",
    b"99999999999999999999",
    b"1e999",
    b"nan",
)
"""What counts and sizes in text are replaced by."""


def mutate(data: bytes, rng: np.random.Generator) -> bytes:
    """``data`` after one to four random changes."""
    out = bytearray(data)
    for _ in range(int(rng.integers(1, 5))):
        _CHANGES[int(rng.integers(len(_CHANGES)))](out, rng)
    return bytes(out)


def _flip(out: bytearray, rng: np.random.Generator) -> None:
    for _ in range(int(rng.integers(1, 8))):
        if out:
            out[int(rng.integers(len(out)))] = int(rng.integers(256))


def _flip_early(out: bytearray, rng: np.random.Generator) -> None:
    if out:
        out[int(rng.integers(min(len(out), 64)))] ^= 1 << int(rng.integers(8))


def _truncate(out: bytearray, rng: np.random.Generator) -> None:
    del out[int(rng.integers(len(out) + 1)) :]


def _drop(out: bytearray, rng: np.random.Generator) -> None:
    start = int(rng.integers(len(out) + 1))
    del out[start : start + int(rng.integers(1, 40))]


def _repeat(out: bytearray, rng: np.random.Generator) -> None:
    start = int(rng.integers(len(out) + 1))
    out[start:start] = out[start : start + int(rng.integers(1, 200))]


def _insert(out: bytearray, rng: np.random.Generator) -> None:
    start = int(rng.integers(len(out) + 1))
    out[start:start] = rng.bytes(int(rng.integers(1, 20)))


def _fill(out: bytearray, rng: np.random.Generator) -> None:
    start = int(rng.integers(len(out) + 1))
    length = min(int(rng.integers(1, 16)), len(out) - start)
    out[start : start + length] = bytes([int(rng.choice([0, 255, 127, 128]))]) * length


def _number(out: bytearray, rng: np.random.Generator) -> None:
    """Replace a run of digits by a number that breaks naive arithmetic."""
    head = bytes(out[:4096])
    starts = [i for i, c in enumerate(head) if 48 <= c <= 57 and (i == 0 or not 48 <= head[i - 1] <= 57)]
    if starts:
        start = end = starts[int(rng.integers(len(starts)))]
        while end < len(out) and 48 <= out[end] <= 57:
            end += 1
        out[start:end] = NUMBERS[int(rng.integers(len(NUMBERS)))]


_CHANGES = (_flip, _flip_early, _truncate, _drop, _repeat, _insert, _fill, _number)
