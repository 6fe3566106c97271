"""Frames as their sources give them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cags_common.splats import Ids, Splats


@dataclass(frozen=True, eq=False)
class Look:
    """One frame as its source gives it, and how it connects to the one before."""

    splats: Splats  # [n]
    known: Ids | None  # [n] the source's own identities
    rows: NDArray[np.int64] | None  # [n] row of the frame before, or -1; None for known identities and the first frame
