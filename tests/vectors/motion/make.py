"""Write a vector file of chunks of motion as this program encodes them: ``python tests/vectors/motion/make.py FILE``.

A file that is committed is never written again: a change of the format adds a new one. Beside the payloads of each
chunk stand the arrays that they decode to, and its splats at a time.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

from cags_common.motion.apply import Looks, Steps, evaluate
from cags_common.motion.chunk import Blocks, ChunkDecoder, encode

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
    shifts, turns = (random.integers(-4000, 4000, (9, 5, 3)).astype(np.int32) for _ in range(2))
    return {
        "everything": {
            "moves": smooth(random, 8, 40, 3, 1.0),
            "turns": smooth(random, 8, 40, 4, 0.25),
            "starts": True,
            "lives": lives,
            "fades": fades,
            "blocks": Blocks(8, 0.0078125, shifts, turns),
        },
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
            "moves": smooth(random, 11, 6, 3, 999_999.0),
            "turns": None,
            "starts": True,
            "curved": (True, False),
        },
        "all-still": {"moves": np.full((4, 9, 3), 0.5), "turns": None, "starts": True},
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
    """Fractions that float32 holds."""
    at = np.arange(splats, dtype=np.float32)[:, None]
    quats = np.tile(np.float32([0.5, 0.5, -0.5, 0.5]), (splats, 1))
    return Looks((at * np.float32([1, -0.5, 0.25])) / 8, quats, at[:, 0] / 4 - 2)


def steps_of(splats: int) -> Steps:
    """One step for all."""
    return Steps(np.full(splats, 0.03125, np.float32), np.full(splats, 0.015625, np.float32))


def arrays_of(payloads: list[bytes], *, native: bool | None = None) -> dict[str, np.ndarray]:
    """What ``payloads`` decode to, level by level."""
    decoder, out = ChunkDecoder(payloads[0], native=native), {}
    for level in range(len(payloads)):
        if level:
            decoder.add_level(payloads[level])
        chunk = decoder.chunk
        out |= {f"{level}-{name}": getattr(chunk, name).copy() for name in ARRAYS if getattr(chunk, name) is not None}
    if chunk.blocks is not None:
        out |= {"shifts": chunk.blocks.shifts, "block_turns": chunk.blocks.turns}
    moved = evaluate(chunk, TIME, looks_of(chunk.splats), steps_of(chunk.splats))
    return out | {"means": moved.means, "quats": moved.quats, "logits": moved.logit_opacities}


def main(path: Path) -> None:
    """Write the file."""
    out: dict[str, np.ndarray] = {}
    for name, options in cases().items():
        payloads = encode((3, 1), **options)
        out |= {f"{name}/payload-{i}": np.frombuffer(payload, np.uint8) for i, payload in enumerate(payloads)}
        out |= {f"{name}/{key}": array for key, array in arrays_of(list(payloads)).items()}
    np.savez_compressed(path, **out)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
