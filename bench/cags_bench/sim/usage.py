"""Accounts for the bytes that arrived: shown in some picture, or wasted."""

from __future__ import annotations

from collections.abc import Iterable

from cags_client.frame.pipeline import ClientPipeline
from cags_client.frame.presented import PresentedFrame
from cags_client.playback.jobs import DataEvent
from cags_protocol import events as ev

LayerKey = tuple[int, int, int]
"""Source frame, tile and LoD."""


class Usage:
    """Account of payload bytes per layer and per reference picture.

    A layer is used once a presented picture shows a splat of its tile at that LoD or a higher one; a reference picture
    once a frame was restored from it. Duplicates count as wasted.
    """

    def __init__(self) -> None:
        self._layers: dict[LayerKey, int] = {}
        self._references: dict[int, int] = {}  # index in order of arrival -> bytes
        self._numbers: dict[int, int] = {}  # sequence number -> index of its newest picture
        self._used_layers: dict[tuple[int, int], int] = {}  # source frame, tile -> LoDs shown
        self._used_references: set[int] = set()
        self._arrived_bytes = self._twice_bytes = 0

    def arrived(self, events: Iterable[DataEvent]) -> None:
        """Messages that will be decoded next."""
        for event in events:
            match event:
                case ev.TileReceived(message, payload):
                    self._arrived_bytes += len(payload)
                    for lod, size in enumerate(message.sizes, start=message.from_lod):
                        key = message.frame, message.tile, lod
                        self._twice_bytes += size if key in self._layers else 0
                        self._layers[key] = size
                case ev.ReferenceReceived(reference, payload):
                    if not payload:  # a reference of the kind "nothing"
                        continue
                    self._arrived_bytes += len(payload)
                    self._numbers[reference.seq] = len(self._references)
                    self._references[len(self._references)] = len(payload)

    def shown(self, presented: PresentedFrame, pipeline: ClientPipeline) -> None:
        """A picture was presented."""
        for key, lods in pipeline.visible_lods(presented.camera).items():
            self._used_layers[key] = max(lods, self._used_layers.get(key, 0))
        if presented.reference is not None and presented.reference.seq in self._numbers:
            self._used_references.add(self._numbers[presented.reference.seq])

    def wasted_bytes(self, dropped_bytes: int) -> int:
        """Payload bytes that no picture used, plus the ``dropped_bytes`` of messages that never completed."""
        layers = sum(
            size for (frame, tile, lod), size in self._layers.items() if lod >= self._used_layers.get((frame, tile), 0)
        )
        references = sum(size for key, size in self._references.items() if key not in self._used_references)
        return layers + references + self._twice_bytes + dropped_bytes

    @property
    def arrived_bytes(self) -> int:
        """Payload bytes of tiles and references that arrived."""
        return self._arrived_bytes
