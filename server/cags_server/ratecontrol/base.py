"""The rate-adaptation seam: what the client holds and sees in, what to send next out. A policy knows no session."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from cags_common.tiles.kinds import TileKind


@dataclass(frozen=True, slots=True)
class TileView:
    """One tile that owns splats which are visible from the predicted pose.

    ``depth`` counts the LoDs that the client holds or that are on their way, from LoD 0 without a gap; 0 is a tile of
    which nothing was sent. ``lod_bytes[L]`` is the size of LoD L, 0 for one that the client holds already above a gap.
    """

    frame: int
    tile: int
    depth: int
    visible: int
    lod_bytes: tuple[int, ...]
    weight: float = 1.0
    """Share of the picture that its visible splats make up (any common scale)."""
    frames_left: float = 1.0
    """Frames for which those splats will be seen before the media replaces them, about."""
    passing: bool = False
    """Whether the media replaces them so soon that their detail is worth nothing late."""
    replaces: float = 0.0
    """Share of its splats that replace older ones, which are shown until it comes; of looks, only where it is new."""
    stale_frames: float = 1.0
    """For how long what it changes will have been out of date when the frame is displayed, in the mean; only where it
    is new.
    """
    kind: TileKind = TileKind.LOOKS
    """What it brings."""
    motion_bytes: float = 0.0
    """Of a chunk of motion: bytes of its lowest level per frame of its span; 0: unknown."""
    after: tuple[int, int] | None = None
    """Looks (media frame, tile) that the client lacks and without which it is worth nothing; None: it lacks none."""

    @property
    def max_depth(self) -> int:
        """LoDs that this tile has."""
        return len(self.lod_bytes)

    @property
    def complete(self) -> bool:
        """Whether the client has all of it."""
        return self.depth >= self.max_depth


def motion_density(views: Sequence[TileView]) -> float:
    """Bytes of motion per frame and unit of weight, over all motion among ``views``; 0 without any."""
    motion = [view for view in views if view.kind == TileKind.MOTION]
    weight = sum(view.weight for view in motion)
    return sum(view.motion_bytes for view in motion) / weight if weight else 0.0


def mean_level(views: Sequence[TileView]) -> float:
    """Levels that the client holds of the looks among ``views``, weighted by their share of the picture; 0 for none."""
    looks = [view for view in views if view.kind == TileKind.LOOKS]
    whole = sum(view.weight for view in looks)
    return sum(view.weight * view.depth for view in looks) / whole if whole else 0.0


UNBOUNDED_BYTES = 1 << 40
"""More than any link carries."""


@dataclass(frozen=True, slots=True)
class Observation:
    """What a rate policy may look at when media frame ``frame`` is planned."""

    frame: int
    budget_bytes: int  # what tiles may take until the next frame is planned; the reference is already paid for
    tiles: tuple[TileView, ...]
    lod_gains_db: tuple[float, ...]  # measured quality gain of each LoD; [0] is the base layer's
    message_overhead_bytes: int  # wire cost of one more message
    waiting_us: int = 0  # how long the oldest undelivered tile has been on its way
    layered: bool = True  # LoDs add up; else LoD L is the whole tile at quality L, and replaces what was sent
    timely_bytes: int = UNBOUNDED_BYTES  # of them, what may go to what must arrive before the frame is displayed
    alone_bytes: int = 0  # instead of all that: what one message may take that stays, if nothing goes beside it
    frame_bytes: float = UNBOUNDED_BYTES  # what the link carries in the time of a media frame
    still_errors: tuple[tuple[float, float], ...] = ()
    """(frames, squared error relative to a base layer's) of splats that have stood still for so long, as measured, by
    rising frames; empty if unknown.
    """
    outdated_errors: tuple[tuple[float, float], ...] = ()
    """The same for splats that have missed updates for so long."""
    motion_density: float = 0.0
    """Bytes of motion (:attr:`TileView.motion_bytes`) per unit of weight, over all that is in view; 0: unknown."""


@dataclass(frozen=True, slots=True)
class Upgrade:
    """LoDs ``from_lod`` .. ``to_lod`` - 1 of a tile are to be sent; of a tile that is not layered, the last alone."""

    frame: int
    tile: int
    from_lod: int
    to_lod: int
    urgent: bool = False
    """Its detail, too, is worth nothing late."""
    together: int = 1
    """LoDs of a new tile that travel in one message: fewer would look worse than none, or worse than what is around."""


@dataclass(frozen=True, slots=True)
class Decision:
    """What to send, in order, and what it costs."""

    upgrades: tuple[Upgrade, ...]
    bytes: int


class RatePolicy(Protocol):
    """Decides what to send within a budget. Pure: the same observation gives the same decision."""

    def decide(self, observation: Observation) -> Decision:
        """Upgrades in the order of sending, at most one a tile; their cost exceeds neither bound, but by one alone."""
        ...
