"""Frames as their sources give them."""

from __future__ import annotations

from dataclasses import dataclass

from cags_common.splats import Ids, Splats


@dataclass(frozen=True, eq=False)
class Look:
    """One frame as its source gives it."""

    splats: Splats  # [n]
    known: Ids | None  # [n] the source's own identities
