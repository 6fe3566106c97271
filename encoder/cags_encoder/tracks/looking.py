"""A frame and its identities as read from the source."""

from __future__ import annotations

from dataclasses import dataclass

from cags_common.splats import Ids, Splats


@dataclass(frozen=True, eq=False)
class Look:
    """One frame as read from the source."""

    splats: Splats  # [n]
    known: Ids | None  # [n] identities known to the source
