"""A small static capture that anybody recognises: a red, a green and a blue ball on a grey disc, +Y down."""

from __future__ import annotations

import numpy as np

from cags_common.splats import SH_C0, Splats

BALLS = (((-0.9, 0.0, 0.0), (0.85, 0.1, 0.1)), ((0.0, 0.0, 0.8), (0.1, 0.75, 0.15)), ((0.9, 0.0, 0.0), (0.1, 0.2, 0.9)))
RADIUS, GROUND = 0.4, 0.42


def three_balls(per_ball: int = 2500, ground: int = 4000) -> Splats:
    """Surfaces of small flat splats, SH degree 0."""
    rng = np.random.default_rng(5)
    means, colours = [], []
    for centre, colour in BALLS:
        direction = rng.normal(size=(per_ball, 3))
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        means.append(np.asarray(centre) + RADIUS * direction)
        light = 0.75 - 0.35 * direction[:, 1:2]
        colours.append(np.clip(np.asarray(colour) * light + 0.05, 0, 1))
    angle, out = rng.uniform(0, 2 * np.pi, ground), 1.8 * np.sqrt(rng.uniform(0, 1, ground))
    means.append(np.stack([out * np.cos(angle), np.full(ground, GROUND), out * np.sin(angle)], axis=1))
    colours.append(np.full((ground, 3), 0.45) + rng.normal(0, 0.03, (ground, 1)))
    n = 3 * per_ball + ground
    quats = np.zeros((n, 4), np.float32)
    quats[:, 0] = 1
    scales = np.log(np.concatenate([np.full(3 * per_ball, 0.02), np.full(ground, 0.035)]))
    return Splats(
        np.concatenate(means).astype(np.float32),
        quats,
        np.repeat(scales[:, None], 3, axis=1).astype(np.float32),
        np.full(n, 3.0, np.float32),
        ((np.concatenate(colours) - 0.5) / SH_C0).astype(np.float32),
        np.zeros((n, 0, 3), np.float32),
    )
