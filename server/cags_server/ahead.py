"""Which frame's tiles go out beside a reference."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Ahead:
    """The frame whose tiles go out beside a reference: they are there before its own reference is made."""

    frame: int
    display_us: int  # client clock
