"""The work that a player hands out: what to decode, what to draw. Run inline or in an executor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

from cags_client.pipeline import ClientPipeline
from cags_client.presented import PresentedFrame
from cags_common.errors import DecodeError
from cags_common.geometry import Pose
from cags_common.held_tile import HeldTile
from cags_protocol import events as ev


@dataclass(frozen=True)
class Restarted:
    """From here on data comes over another connection, whose reference video is numbered from 1 again."""


DataEvent: TypeAlias = ev.TileReceived | ev.ReferenceReceived | ev.FrameEnded | Restarted


@dataclass(frozen=True)
class DecodeResult:
    """What a :class:`Decode` found."""

    errors: tuple[DecodeError, ...]
    needs_idr: bool
    whole: int
    """The latest frame whose end was decoded; -1 if none was."""
    dropped: tuple[HeldTile, ...] = ()
    """What had come and was given up for want of memory."""


@dataclass(frozen=True, eq=False)
class Decode:
    """Messages to decode; :meth:`run` returns what came of it.

    Tiles go first, all at once and dequantised: the end of a frame never overtakes what belongs to it.
    """

    events: tuple[DataEvent, ...]
    pipeline: ClientPipeline

    def run(self) -> DecodeResult:
        """Decode into the pipeline. A damaged message is left out and reported; the others count."""
        tiles = [(event.message, event.payload) for event in self.events if isinstance(event, ev.TileReceived)]
        errors = self.pipeline.on_tiles(tiles) + self.pipeline.flush()
        needs_idr, whole = False, -1
        for event in self.events:
            try:
                match event:
                    case ev.ReferenceReceived(reference, payload):
                        needs_idr = not self.pipeline.on_reference(reference, payload)
                    case ev.FrameEnded(end, payload):
                        self.pipeline.on_frame_end(end, payload)
                        whole = max(whole, end.frame)
                    case Restarted():
                        self.pipeline.restart_references()
            except DecodeError as error:
                errors.append(error)
                needs_idr |= isinstance(event, ev.ReferenceReceived)
        return DecodeResult(tuple(errors), needs_idr, whole, tuple(self.pipeline.take_dropped()))


@dataclass(frozen=True, eq=False)
class Present:
    """A frame to draw: due at ``due_us``, seen from ``pose`` (sampled then)."""

    frame: int
    due_us: int
    pose: Pose
    pipeline: ClientPipeline
    traffic: Traffic
    share: float = 0.0
    """Media frames after ``frame``, where it is a picture between two of them."""

    def run(self) -> PresentedFrame:
        """Draw it."""
        return self.pipeline.present(self.frame, self.pipeline.camera(self.pose), self.share)


@dataclass(frozen=True, slots=True)
class Traffic:
    """Payload bytes that arrived since the frame before."""

    tiles_bytes: int = 0
    reference_bytes: int = 0
