"""What a play has counted."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(eq=False)
class PlayStats:
    """Counts over a whole play."""

    frames: int = 0
    """Media frames presented."""
    interpolated: int = 0
    """Pictures presented between them."""
    missed: int = 0
    """Presented without all of their data."""
    dropped: int = 0
    """Not presented because the one after was due already."""
    decode_errors: int = 0
    keyframe_requests: int = 0
    bytes_tiles: int = 0
    bytes_reference: int = 0
    bytes_other: int = 0
    first_byte_us: int | None = None
    last_byte_us: int = 0
    first_picture_us: int | None = None
    """When the first picture had been drawn, of a reference or of the first frame."""
    started_us: int | None = None
    """When the first frame was due."""
    reconnects: int = 0
    """Dropped connections that were taken up again."""
    away_us: int = 0
    """Time without a session, in all."""
    notices: list[str] = field(default_factory=list)
