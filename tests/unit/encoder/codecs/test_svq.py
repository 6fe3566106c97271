"""Grids of positions."""

import numpy as np

from cags_encoder.codecs.svq import SMALL_SPLATS, SvqCodec, SvqSplats
from cags_encoder.quantiser.training import Quantiser

STEP = 1 / 8


def tile(radii: np.ndarray[tuple[int, ...], np.dtype[np.float32]], extent: float) -> SvqSplats:
    means = np.random.default_rng(1).uniform(-extent, extent, (len(radii), 3)).astype(np.float32)
    return SvqSplats(means, radii.astype(np.float32), {})


def codec() -> SvqCodec:
    return SvqCodec(Quantiser({}, canonical_axes=True), (), (), None, STEP)


def test_the_smaller_splats_of_a_tile_set_its_grid() -> None:
    radii = np.random.default_rng(0).lognormal(-4, 1, 2000)
    grid = codec().grid(tile(radii, 1.0))
    assert STEP / 2 * np.quantile(radii, SMALL_SPLATS) <= grid.step <= STEP * np.quantile(radii, SMALL_SPLATS)


def test_splats_without_a_size_do_not_refine_the_grid_of_the_others() -> None:
    """Captures have needles of no width: a grid as fine as these took two thirds more bytes for the lowest level."""
    rng = np.random.default_rng(0)
    radii = np.r_[rng.lognormal(-4, 1, 1800), np.full(200, 1e-9)]
    assert codec().grid(tile(radii, 1.0)).step > STEP / 2 * np.quantile(radii[:1800], 0.1)
