"""Moving splats without a scene: tiles whose motion has positions and rotations."""

from __future__ import annotations

import numpy as np

from cags_common.motion import chunk
from cags_common.motion.apply import Steps
from cags_common.motion.chunk import ChunkDecoder
from cags_common.motion.neighbours import Anchors
from cags_common.splats import Splats
from cags_common.tiles.splat_buffer import Slot, SplatBuffer

TILE, SPAN = 8_000, 32


def moving_buffer(count: int, threads: int, seed: int = 0) -> SplatBuffer:
    """A buffer of ``count`` splats in tiles of :data:`TILE`, each with one chunk of motion from frame 0 on."""
    random, buffer = np.random.default_rng(seed), SplatBuffer(count, 0, threads=threads)
    for number, first in enumerate(range(0, count, TILE)):
        ids = np.arange(first, min(first + TILE, count), dtype=np.int32)
        n = len(ids)
        steps = Steps(np.full(n, 1e-4, np.float32), np.full(n, 1e-3, np.float32))
        slot = Slot(number, (0, number), steps=steps)
        buffer.add(slot)
        splats = _splats(n, random)
        buffer.write(slot, 0, ids, splats)
        anchors = Anchors(splats.means, steps.moves, steps.turns)
        buffer.set_motion(slot.key, 0, _chunk(anchors, number, random))
    buffer.move(0.0)
    return buffer


def _splats(n: int, random: np.random.Generator) -> Splats:
    quats = random.normal(size=(n, 4))
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    means, colours = (random.normal(size=(n, 3)).astype(np.float32) for _ in range(2))
    sizes, opacities = np.full((n, 3), -4.0, np.float32), np.zeros(n, np.float32)
    return Splats(means, quats.astype(np.float32), sizes, opacities, colours, np.zeros((n, 0, 3), np.float32))


def _chunk(anchors: Anchors, number: int, random: np.random.Generator) -> chunk.Chunk:
    times, n = np.arange(SPAN + 1)[:, None, None], len(anchors)
    moves = 40 * np.sin(times / 5 + random.uniform(0, 6, (1, n, 3)))
    turns = 8 * np.sin(times / 7 + random.uniform(0, 6, (1, n, 4)))
    payloads = chunk.encode((0, number), anchors, moves, turns, starts=True)
    decoder = ChunkDecoder(payloads[0], anchors)
    for payload in payloads[1:]:
        decoder.add_level(payload)
    return decoder.chunk
