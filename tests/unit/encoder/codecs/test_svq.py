"""Grids of positions."""

import numpy as np

from cags_encoder.codecs.svq import MOST_SPREAD, SMALL_SPLATS, SvqCodec, SvqSplats
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


def test_few_small_splats_among_a_far_background_keep_their_place() -> None:
    rng = np.random.default_rng(0)
    background, near = rng.lognormal(1, 0.3, 1800), rng.lognormal(-4, 0.3, 200)
    mixed = tile(np.r_[background, near], 500.0)
    off = np.abs(codec().means_at(mixed) - mixed.means).max(axis=1)
    assert np.mean(off[1800:] / near) < STEP * MOST_SPREAD / 2
