"""Blobs (codebooks, network weights): cut into chunks by the server, put together by the client."""

from __future__ import annotations

from collections.abc import Iterator

from cags_common.errors import ProtocolError
from cags_protocol.delivery.assembly import Partial
from cags_protocol.wire import limits
from cags_protocol.wire.messages import Blob

CODEBOOKS_BLOB, BASE_CODEBOOKS_BLOB, WEIGHTS_BLOB = "codebooks", "base-codebooks", "weights"
"""Names of the blobs that a server sends: ``codebooks.bin`` of the bundle; before it the part of that which tiles
need at LoD 0, for a first picture; and the weights of a restorer.
"""

MAX_BLOBS_AT_ONCE = 8
"""Blobs that a client keeps half received."""


def blob_chunks(name: str, data: bytes) -> Iterator[tuple[Blob, memoryview]]:
    """Messages that carry ``data``: at least one, so that an empty blob arrives too."""
    view = memoryview(data)
    for offset in range(0, max(len(data), 1), limits.BLOB_CHUNK_BYTES):
        yield Blob(name, offset, len(data)), view[offset : offset + limits.BLOB_CHUNK_BYTES]


class BlobAssembler:
    """Collects chunks in any order; memory follows what was received, not what was promised."""

    def __init__(self) -> None:
        self._partials: dict[str, Partial] = {}
        self._bytes = 0

    def add(self, blob: Blob, chunk: memoryview) -> bytes | None:
        """Take a chunk; the whole blob once it is complete. A repeated chunk is ignored.

        Raises :class:`ProtocolError` for chunks that contradict each other and for more than the bounds allow.
        """
        name = f"blob {blob.name!r}"
        partial = self._partials.setdefault(blob.name, Partial(blob.total))
        if len(self._partials) > MAX_BLOBS_AT_ONCE:
            raise ProtocolError(f"{name}: more than {MAX_BLOBS_AT_ONCE} blobs half sent at once")
        if partial.total != blob.total:
            raise ProtocolError(f"{name}: has a total of {blob.total} bytes, in an earlier chunk {partial.total}")
        if not partial.holds(blob.offset):
            self._bytes += len(chunk)
            partial.add(blob.offset, chunk)
        if self._bytes > limits.MAX_BLOB_BYTES:
            raise ProtocolError(f"{name}: more than {limits.MAX_BLOB_BYTES} bytes half sent")
        if partial.received < partial.total:
            return None
        del self._partials[blob.name]
        self._bytes -= partial.received
        return partial.joined(name)
