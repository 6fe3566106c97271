"""Looks by which motion is told, where a test has no tile of them."""

from __future__ import annotations

import numpy as np

from cags_common.motion.neighbours import Anchors


def together(count: int) -> Anchors:
    """Splats of one size at one place."""
    ones = np.ones(count, np.float32)
    return Anchors(np.zeros((count, 3), np.float32), ones, ones)


def any_looks(random: np.random.Generator, count: int, kind: str) -> Anchors:
    """Of one of :data:`KINDS`, drawn at random."""
    places, sizes = random.normal(size=(count, 3)), random.uniform(1e-3, 1e-2, (2, count))
    if kind == "shared places":
        places = places[random.integers(0, max(count // 2, 1), count)] if count else places
    elif kind == "a coarse grid":
        places = np.rint(places)
    elif kind == "in a line":
        places = places[:, :1] * random.normal(size=3)
    elif kind in ("huge", "tiny"):
        places *= 1e30 if kind == "huge" else 1e-30
    elif kind == "any size":
        sizes = 10.0 ** random.uniform(-30, 30, (2, count))
    elif kind == "no size":
        sizes[random.random((2, count)) < random.choice([0.3, 1.0])] = 0
    return Anchors(*(np.ascontiguousarray(part, dtype=np.float32) for part in (places, *sizes)))


KINDS = ("scattered", "shared places", "a coarse grid", "in a line", "huge", "tiny", "any size", "no size")


def scattered(count: int, seed: int = 0) -> Anchors:
    """Splats of several sizes in a ball of a metre, in no order."""
    random = np.random.default_rng(seed)
    moves, turns = (random.choice([1e-3, 2e-3, 8e-3], count).astype(np.float32) for _ in range(2))
    return Anchors(random.normal(size=(count, 3)).astype(np.float32), moves, turns)
