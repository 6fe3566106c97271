"""Write a vector file of chunks of motion as this program encodes them: ``python tests/vectors/motion/make.py FILE``.

A file that is committed is never written again: a change of the format adds a new one. Beside the payloads of each
chunk stand the arrays that they decode to, and its splats at a time. Names of cases after FILE: only these.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

from cags_common.motion.apply import Looks, Steps, evaluate
from cags_common.motion.chunk import ChunkDecoder, encode
from cags_common.motion.neighbours import Anchors

ARRAYS = ("moves", "turns", "lives", "fades")
TIME = 1.625
"""Frames from each chunk's first at which its splats are written down."""


def smooth(random: np.random.Generator, span: int, splats: int, parts: int, size: float) -> np.ndarray:
    """Eighths of a unit, so that no rounding of a processor's tells."""
    steps = random.integers(-8, 9, (span + 1, splats, parts)) * size
    return np.rint(8 * np.cumsum(steps, axis=0)) / 8


def cases() -> dict[str, dict[str, Any]]:
    """What :func:`encode` takes, by name."""
    random = np.random.default_rng(16)
    lives = random.integers(0, 10, 40).astype(np.uint8)
    fades = np.stack([random.integers(0, 49, 40), random.integers(-9, 10, 40)], axis=1)
    return {
        "everything": {
            "moves": smooth(random, 8, 40, 3, 1.0),
            "turns": smooth(random, 8, 40, 4, 0.25),
            "starts": True,
            "lives": lives,
            "fades": fades,
        },
        "field": {"moves": field(9, 300, 3), "turns": field(9, 300, 4), "starts": True, "curved": (True, False)},
        "no-start": {"moves": smooth(random, 5, 7, 3, 2.0), "turns": None, "starts": False},
        "large": {"moves": smooth(random, 3, 6, 3, 99_999.0), "turns": None, "starts": True},
        "rotations": {"moves": None, "turns": smooth(random, 64, 3, 4, 1.0), "starts": False},
        "many-lanes": {"moves": smooth(random, 6, 900, 3, 0.25), "turns": None, "starts": True},
        "no-splats": {"moves": np.zeros((2, 0, 3)), "turns": None, "starts": True},
        "finer": {
            "moves": smooth(random, 4, 9, 3, 1.0),
            "turns": smooth(random, 4, 9, 4, 0.25),
            "starts": True,
            "finer": (3, 1),
            "told": (2, 1),
        },
        "some-still": {
            "moves": smooth(random, 7, 50, 3, 1.0) * (np.arange(50) % 3 == 0)[:, None],
            "turns": smooth(random, 7, 50, 4, 0.25) * (np.arange(50) % 5 == 0)[:, None],
            "starts": True,
        },
        "curved": {
            "moves": smooth(random, 16, 33, 3, 1.0),
            "turns": smooth(random, 16, 33, 4, 0.25),
            "starts": True,
            "curved": (True, True),
        },
        "curved-uneven": {
            "moves": smooth(random, 13, 9, 3, 3.0),
            "turns": None,
            "starts": False,
            "curved": (True, False),
        },
        "curved-large": {
            "moves": smooth(random, 11, 6, 3, 199_999.0),
            "turns": None,
            "starts": True,
            "curved": (True, False),
        },
        "all-still": {"moves": np.full((4, 9, 3), 0.5), "turns": None, "starts": True},
        "straight": {
            "moves": np.rint(np.linspace(0.0, 96.0, 13))[:, None, None] * random.integers(-4, 5, (1, 20, 3)),
            "turns": smooth(random, 12, 20, 4, 0.25) * (np.arange(13) > 9)[:, None, None],
            "starts": True,
        },
        "one-frame": {
            "moves": smooth(random, 1, 3, 3, 1.0),
            "turns": None,
            "starts": False,
            "lives": np.array([0, 1, 2], np.uint8),
        },
        "coarse-first": {
            "moves": smooth(random, 6, 21, 3, 8.0),
            "turns": smooth(random, 6, 21, 4, 1.0),
            "starts": True,
            "finer": (10, 2),
            "told": (4, 3),
            "deadzones": ((0.2, 0.2, 0.1, 0.15), (0.2, 0.1, 0.15, 0.15)),
        },
    }


def looks_of(splats: int) -> Looks:
    """Fractions that float32 holds, along a winding line."""
    at = np.arange(splats, dtype=np.float32)
    quats = np.tile(np.float32([0.5, 0.5, -0.5, 0.5]), (splats, 1))
    means = np.stack([at, at % 7 * 2, at * at % 32], axis=1) / 8
    return Looks(means.astype(np.float32), quats, at / 4 - 2)


def steps_of(splats: int) -> Steps:
    """Large, middle and small splats in turn."""
    size = np.float32(2.0) ** -(np.arange(splats) % 3).astype(np.float32)
    return Steps(size / 32, size / 64)


def anchors_of(splats: int) -> Anchors:
    """What the chunks are told by."""
    steps = steps_of(splats)
    return Anchors(looks_of(splats).means, steps.moves, steps.turns)


def splats_of(case: dict[str, Any]) -> int:
    """How many splats a case has."""
    moves, turns = case["moves"], case["turns"]
    return int((turns if moves is None else moves).shape[1])


def field(span: int, splats: int, parts: int) -> np.ndarray:
    """Residuals in each splat's own unit of motion that bends smoothly in space, and a little apart from it."""
    time = np.arange(span + 1)[:, None]
    place, units = looks_of(splats).means, steps_of(splats).moves * 32
    bent = np.stack([time * place[:, 0] + time * time * place[:, 1] / 4 + part for part in range(parts)], axis=2)
    apart = (np.arange(splats)[None, :, None] * 5 + time[:, :, None] * 3 + np.arange(parts)) % 4 / 8
    return np.rint(8 * (bent / units[None, :, None] + apart)) / 8


def arrays_of(payloads: list[bytes], splats: int, *, native: bool | None = None) -> dict[str, np.ndarray]:
    """What ``payloads`` decode to, level by level."""
    decoder, out = ChunkDecoder(payloads[0], anchors_of(splats), native=native), {}
    for level in range(len(payloads)):
        if level:
            decoder.add_level(payloads[level])
        chunk = decoder.chunk
        out |= {f"{level}-{name}": getattr(chunk, name).copy() for name in ARRAYS if getattr(chunk, name) is not None}
    moved = evaluate(chunk, TIME, looks_of(chunk.splats), steps_of(chunk.splats))
    return out | {"means": moved.means, "quats": moved.quats, "logits": moved.logit_opacities}


def encoded(case: dict[str, Any], *, native: bool | None = None) -> tuple[bytes, ...]:
    """Payloads of a case."""
    return encode((3, 1), anchors_of(splats_of(case)), native=native, **case)


def main(path: Path, *names: str) -> None:
    """Write the file."""
    out: dict[str, np.ndarray] = {}
    for name, options in cases().items():
        if names and name not in names:
            continue
        payloads, splats = encoded(options), splats_of(options)
        out |= {f"{name}/payload-{i}": np.frombuffer(payload, np.uint8) for i, payload in enumerate(payloads)}
        out |= {f"{name}/{key}": array for key, array in arrays_of(list(payloads), splats).items()}
    np.savez_compressed(path, **out)


if __name__ == "__main__":
    main(Path(sys.argv[1]), *sys.argv[2:])
