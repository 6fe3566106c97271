"""What one client gets when it joins: codebooks, a first picture, and a restorer's weights."""

from __future__ import annotations

from cags_common.geometry import Camera
from cags_protocol import events as ev
from cags_protocol.blobs import CODEBOOKS_BLOB, WEIGHTS_BLOB, blob_chunks
from cags_protocol.messages import TileLayers
from cags_server.scene.library import SceneLibrary
from cags_server.session.tile_sender import BASE_PRIORITY, ENHANCEMENT_PRIORITY, TileSender
from cags_server.visibility.bounds import Opening

BLOB_PRIORITY = 0
"""Decoders' tables: nothing can be shown without them."""

WEIGHTS_PRIORITY = ENHANCEMENT_PRIORITY
"""A restorer's weights: playing goes on without them, so that base layers go first."""


class Joining:
    """Of one client, from its Hello until its first picture is there."""

    def __init__(self, library: SceneLibrary, tiles: TileSender) -> None:
        self.resumed = False
        """Whether the client has the codebooks and the weights from an earlier session."""
        self._library, self._tiles = library, tiles
        self._opening: Opening | None = None

    def messages(self, frame: int, camera: Camera, now_us: int) -> list[ev.Outgoing]:
        """Codebooks, then the base layers of ``frame``, those in view of ``camera`` first; the weights come last."""
        tiles = self._tiles.beginning(frame, camera)
        first = [each.message for each in tiles if each.priority == BASE_PRIORITY]
        in_view = [(message.frame, message.tile) for message in first if isinstance(message, TileLayers)]
        self._opening = Opening(frame, in_view, now_us)
        return [*self._codebooks(), *tiles, *self._weights()]

    def settled(self, message: TileLayers) -> None:
        """Layers were delivered, or will never be."""
        if self._opening is not None:
            self._opening.settled(message)

    def due_us(self) -> int | None:
        """When :meth:`end` has something to say."""
        return self._opening.due_us() if self._opening else None

    def end(self, now_us: int) -> list[ev.Outgoing]:
        """The end of the first frame while the link is still busy with it, so that the play can begin."""
        ends = self._opening.end(now_us) if self._opening else []
        return [ev.Outgoing(end, self._library.removed_payload(end.frame), BLOB_PRIORITY) for end in ends]

    def _codebooks(self) -> list[ev.Outgoing]:
        """None for a client that resumes: it could not hold a tile without them."""
        if self.resumed:
            return []
        chunks = blob_chunks(CODEBOOKS_BLOB, self._library.reader.codebooks())
        return [ev.Outgoing(blob, chunk, BLOB_PRIORITY) for blob, chunk in chunks]

    def _weights(self) -> list[ev.Outgoing]:
        if self.resumed or self._library.weights is None:
            return []
        chunks = blob_chunks(WEIGHTS_BLOB, self._library.weights)
        return [ev.Outgoing(blob, chunk, WEIGHTS_PRIORITY) for blob, chunk in chunks]
