"""Small splat clouds for tests of the codec."""

from __future__ import annotations

import numpy as np

from cags_common.splats import SH_REST_OF_DEGREE, Splats
from cags_common.tiles.attributes import ATTRIBUTE_DIMS, unit_quaternions
from cags_common.tiles.svq import Codebook, CodebookSet


def cloud(n: int, seed: int = 0, sh_degree: int = 0) -> Splats:
    """``n`` splats in a unit ball with all attributes varied."""
    random = np.random.default_rng(seed)

    def normal(*shape: int) -> np.ndarray:
        return random.normal(size=shape).astype(np.float32)

    return Splats(
        means=normal(n, 3),
        quats=unit_quaternions(normal(n, 4)),
        log_scales=normal(n, 3) - 4,
        logit_opacities=normal(n) * 2,
        sh0=normal(n, 3),
        sh_rest=normal(n, SH_REST_OF_DEGREE[sh_degree], 3) * 0.1,
    )


def books(
    layer_bits: tuple[int, ...] = (4, 2, 2), seed: int = 0, attributes: tuple[str, ...] | None = None
) -> CodebookSet:
    """Codebooks of random values on steps; SH degree 0 unless ``attributes`` are given."""
    random = np.random.default_rng(seed)
    names = attributes or ("scale", "rotation_real", "rotation_imag", "opacity", "sh0")

    def tables(dim: int) -> tuple[np.ndarray, ...]:
        sizes = np.cumsum(layer_bits)
        return tuple(on_a_grid(random.normal(size=(1 << int(bits), dim))) for bits in sizes)

    return CodebookSet({name: Codebook(name, layer_bits, tables(ATTRIBUTE_DIMS[name])) for name in names})


def on_a_grid(values: np.ndarray) -> np.ndarray:
    """Values below 16 as float32, rounded to steps that a codebook can hold."""
    return (np.rint(values * 1024) / 1024).astype(np.float32)


def with_changes(splats: Splats, **arrays: np.ndarray) -> Splats:
    """A copy with some arrays replaced."""
    return Splats(
        **{name: np.ascontiguousarray(arrays.get(name, array.copy()), np.float32) for name, array in splats.arrays()}
    )
