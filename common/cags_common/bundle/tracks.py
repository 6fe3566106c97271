"""What the tracks of a bundle's splats are like, as the encoder found them: for people who look into bundles."""

from __future__ import annotations

from dataclasses import dataclass

MAX_LIFE_CLASSES = 64


@dataclass(frozen=True, slots=True)
class ChangedShares:
    """Shares of continued splats in which an attribute changes from frame to frame by more than a hundredth of a
    pixel's colour.
    """

    position: float
    rotation: float
    scale: float
    opacity: float
    colour: float
    harmonics: float


@dataclass(frozen=True, slots=True)
class TrackStatistics:
    """Statistics of one clip's tracks."""

    frames: int
    tracks: int
    """Splats that ever began."""
    linked_share: float
    """Share of a later frame's splats that continue one of the frame before, on the mean; 0 in a clip of one frame."""
    life_mean_frames: float
    """Frames that a track is seen in, on the mean. Those that the clip's ends cut count as far as they are seen."""
    life_histogram: tuple[int, ...]
    """Entry k: tracks that are seen in 2**k to 2**(k + 1) - 1 frames."""
    changed: ChangedShares
