"""The work that a player hands out: what to decode, what to draw. Run inline or in an executor."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TypeAlias

from cags_client.frame.pipeline import ClientPipeline
from cags_client.frame.presented import PresentedFrame
from cags_common.errors import DecodeError
from cags_common.geometry import Pose
from cags_common.tiles.inventory import InventoryEntry
from cags_protocol import events as ev


@dataclass(frozen=True)
class Restarted:
    """From here on data comes over another connection, whose references and marks are numbered from 1 again."""

    inventory: tuple[InventoryEntry, ...] = ()
    """What the server was told that the client holds."""


DataEvent: TypeAlias = ev.TileReceived | ev.ReferenceReceived | ev.FrameEnded | ev.MarkReceived | Restarted


@dataclass(frozen=True)
class DecodeResult:
    """What a :class:`Decode` found."""

    errors: tuple[DecodeError, ...]
    needs_idr: bool
    whole: int
    """The latest frame whose end was decoded; -1 if none was."""
    dropped: tuple[InventoryEntry, ...] = ()
    """What had come and was given up for want of memory."""
    references: bool = False
    """Whether a reference was decoded."""


@dataclass(frozen=True, eq=False)
class Decode:
    """Messages to decode; :meth:`run` returns what came of it.

    Between two marks tiles go first, all at once and dequantised: the end of a frame never overtakes what belongs to
    it, and a mark never what came before it.
    """

    events: tuple[DataEvent, ...]
    pipeline: ClientPipeline

    def run(self) -> DecodeResult:
        """Decode into the pipeline. A damaged message is left out and reported; the others count."""
        errors: list[DecodeError] = []
        needs_idr, whole, references = False, -1, False
        for events in _between_marks(self.events):
            tiles = [(event.message, event.payload) for event in events if isinstance(event, ev.TileReceived)]
            errors += self.pipeline.on_tiles(tiles) + self.pipeline.flush()
            for event in events:
                try:
                    match event:
                        case ev.ReferenceReceived(reference, payload):
                            needs_idr = not self.pipeline.on_reference(reference, payload)
                            references |= not needs_idr
                        case ev.FrameEnded(end, payload):
                            self.pipeline.on_frame_end(end, payload)
                            whole = max(whole, end.frame)
                        case ev.MarkReceived(mark):
                            errors += self.pipeline.on_mark(mark)
                        case Restarted(inventory):
                            self.pipeline.restarted(inventory)
                except DecodeError as error:
                    errors.append(error)
                    needs_idr |= isinstance(event, ev.ReferenceReceived)
        dropped = tuple(self.pipeline.take_dropped())
        return DecodeResult(tuple(errors), needs_idr, whole, dropped, references)


def _between_marks(events: tuple[DataEvent, ...]) -> Iterator[tuple[DataEvent, ...]]:
    """``events`` in parts: a mark, and the beginning of another connection, end one and stand alone."""
    first = 0
    for at, event in enumerate(events):
        if isinstance(event, ev.MarkReceived | Restarted):
            yield events[first:at]
            yield (event,)
            first = at + 1
    yield events[first:]


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
    first: bool = False
    """Whether it is the first picture, shown before the play begins."""
    half: bool = False
    """Whether it is worked out at half the pixels a side."""
    still: bool = False
    """Whether the clip stands still there."""

    @property
    def media(self) -> bool:
        """Whether it is a media frame in its turn."""
        return not (self.share or self.first)

    def run(self) -> PresentedFrame:
        """Draw it."""
        camera = self.pipeline.camera(self.pose)
        return self.pipeline.present(self.frame, camera, self.share, half=self.half, still=self.still)


@dataclass(frozen=True, slots=True)
class Traffic:
    """Payload bytes that arrived since the frame before."""

    tiles_bytes: int = 0
    reference_bytes: int = 0
