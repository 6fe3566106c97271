"""What one client gets when it joins: codebooks, a first picture, and a restorer's weights."""

from __future__ import annotations

from collections.abc import Iterable

from cags_common.geometry import Camera
from cags_protocol import events as ev
from cags_protocol.sessions.blobs import BASE_CODEBOOKS_BLOB, CODEBOOKS_BLOB, WEIGHTS_BLOB, blob_chunks
from cags_protocol.wire.messages import FrameEnd, TileLayers
from cags_server.ratecontrol.priorities import BASE_PRIORITY, BLOB_PRIORITY, WEIGHTS_PRIORITY
from cags_server.scene.library import SceneLibrary
from cags_server.scene.tile_map import Key
from cags_server.session.tile_sender import TileSender

PATIENCE_US = 700_000
"""Time after which a first picture of which enough has come is shown as it is."""

ENOUGH = 0.25
"""Share of the tiles in view, nearest first, that make a first picture."""


class FirstFrame:
    """Lets the play begin on a slow link: the first frame is ended once enough of it has come and time is up.

    What is still on its way then fills in while the play goes on.
    """

    def __init__(self, frame: int, in_view: Iterable[Key], now_us: int) -> None:
        """``in_view``: the (media frame, tile) whose base layers are on their way to the first picture of ``frame``."""
        self._frame, self._due_us = frame, now_us + PATIENCE_US
        self._waiting = set(in_view)
        self._enough = len(self._waiting) * (1 - ENOUGH)  # may be missing

    def settled(self, message: TileLayers) -> None:
        """Layers were delivered, or will never be."""
        self._waiting.discard((message.frame, message.tile))

    def due_us(self) -> int | None:
        """When :meth:`end` has something to say; None: not before more has come, or never again."""
        return self._due_us if 0 < len(self._waiting) <= self._enough else None

    def end(self, now_us: int) -> list[FrameEnd]:
        """The end of the first frame, ahead of what is still on its way; once, when it is due."""
        due_us = self.due_us()
        if due_us is None or now_us < due_us:
            return []
        self._waiting.clear()
        return [FrameEnd(self._frame)]


class Startup:
    """What one client is sent from its Hello until its first picture is complete."""

    def __init__(self, library: SceneLibrary, tiles: TileSender) -> None:
        self.resumed = False
        """Whether the client has the codebooks from an earlier session."""
        self._library, self._tiles = library, tiles
        self._first_frame: FirstFrame | None = None

    def messages(self, frame: int, camera: Camera, now_us: int) -> list[ev.Outgoing]:
        """Codebooks of base layers, and the base layers of ``frame`` in view of ``camera``; then whole codebooks, which
        no base layer waits for, the other base layers, and the weights.
        """
        tiles = self._tiles.beginning(frame, camera)
        first = [each.message for each in tiles if each.priority == BASE_PRIORITY]
        in_view = [(message.frame, message.tile) for message in first if isinstance(message, TileLayers)]
        self._first_frame = FirstFrame(frame, in_view, now_us)
        tables, more = self._codebooks()
        shown = sum(each.priority == BASE_PRIORITY for each in tiles)
        return [*tables, *tiles[:shown], *more, *tiles[shown:], *self._weights()]

    def settled(self, message: TileLayers) -> None:
        """Layers were delivered, or will never be."""
        if self._first_frame is not None:
            self._first_frame.settled(message)

    def due_us(self) -> int | None:
        """When :meth:`end` has something to say."""
        return self._first_frame.due_us() if self._first_frame else None

    def end(self, now_us: int) -> list[ev.Outgoing]:
        """The end of the first frame while the link is still busy with it, so that the play can begin."""
        ends = self._first_frame.end(now_us) if self._first_frame else []
        return [ev.Outgoing(end, self._library.removed_payload(end.frame), BLOB_PRIORITY) for end in ends]

    def _codebooks(self) -> tuple[list[ev.Outgoing], list[ev.Outgoing]]:
        """What goes before all tiles, and what goes before levels above the lowest. Nothing for a client that resumes:
        it could not hold a tile without them.
        """
        if self.resumed:
            return [], []
        base, whole = self._library.reader.base_codebooks(), self._library.reader.codebooks()
        if base is None:
            return _blob(CODEBOOKS_BLOB, whole, BLOB_PRIORITY), []
        return _blob(BASE_CODEBOOKS_BLOB, base, BLOB_PRIORITY), _blob(CODEBOOKS_BLOB, whole, BASE_PRIORITY)

    def _weights(self) -> list[ev.Outgoing]:
        """For a client that resumes, too: nothing says whether they had come."""
        if self._library.weights is None:
            return []
        return _blob(WEIGHTS_BLOB, self._library.weights, WEIGHTS_PRIORITY)


def _blob(name: str, data: bytes, priority: int) -> list[ev.Outgoing]:
    return [ev.Outgoing(blob, chunk, priority) for blob, chunk in blob_chunks(name, data)]
