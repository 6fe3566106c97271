"""How exactly a source knows its own values.

Formats with codebooks (SOG, and others that store a byte a value) round each attribute to some 256 values. Where each
frame of a clip was rounded by itself, a splat that does not change jumps to and fro between neighbouring values. Two
values of one splat that lie next to each other in the codebook may be the same, so such a difference is no change.
"""

from __future__ import annotations

import numpy as np

from cags_common.geometry import F32
from cags_common.splats import Splats
from cags_encoder.tracks.rows import bit_keys

COLUMNS = ("log_scales", "sh0", "sh_rest")
"""Attributes that formats round to codebooks."""

FEWEST, MOST = 128, 256
"""Number of different values that a codebook has."""

USES, ROWS = 16, 4
"""Least mean number of uses of a value, and least number of different rows for each value: values that are rounded one
by one combine in many ways, unlike the colours of a palette.
"""

LOOKED_AT = 4096
"""Number of values looked at first: most sources have no codebooks."""


def codebooks(splats: Splats) -> dict[str, F32]:
    """Column of ``splats`` [n] -> the values [k] that it takes, ascending, if these are a codebook's."""
    arrays = dict(splats.arrays())
    found = {name: _codebook(arrays[name]) for name in COLUMNS}
    return {name: book for name, book in found.items() if book is not None}


def step_at(book: F32, values: F32) -> F32:
    """Distance [...] from each of ``values`` [...] to the farther one of the values next to it in the ``book`` [k]."""
    gaps = np.diff(book)
    farther = np.maximum(np.append(gaps, 0), np.append(0, gaps))
    steps: F32 = farther[np.minimum(np.searchsorted(book, values), len(book) - 1)]
    return steps


def _codebook(array: F32) -> F32 | None:
    values = array.ravel()
    if len(values) < USES * FEWEST or len(np.unique(values[:: max(1, len(values) // LOOKED_AT)])) > MOST:
        return None
    book: F32 = np.unique(values)
    if not FEWEST <= len(book) <= MOST or len(values) < USES * len(book):
        return None
    return book if len(np.unique(bit_keys(array))) >= ROWS * len(book) else None
