"""Blobs (codebooks, network weights): cut into chunks by the server, put together by the client."""

from __future__ import annotations

from collections.abc import Iterator

from cags_common.errors import ProtocolError
from cags_protocol import limits
from cags_protocol.messages import Blob

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
        self._parts: dict[str, dict[int, bytes]] = {}
        self._bytes = 0

    def add(self, blob: Blob, chunk: memoryview) -> bytes | None:
        """Take a chunk; the whole blob once it is complete. A repeated chunk is ignored."""
        parts = self._parts.setdefault(blob.name, {})
        if len(self._parts) > MAX_BLOBS_AT_ONCE:
            raise ProtocolError(f"blob {blob.name!r}: more than {MAX_BLOBS_AT_ONCE} blobs half sent at once")
        if blob.offset not in parts:
            self._bytes += len(chunk)
            parts[blob.offset] = bytes(chunk)
        if self._bytes > limits.MAX_BLOB_BYTES:
            raise ProtocolError(f"blob {blob.name!r}: more than {limits.MAX_BLOB_BYTES} bytes half sent")
        if sum(map(len, parts.values())) < blob.total:
            return None
        del self._parts[blob.name]
        data = b"".join(parts[offset] for offset in sorted(parts))
        self._bytes -= len(data)
        if len(data) != blob.total:
            raise ProtocolError(f"blob {blob.name!r}: chunks of {len(data)} bytes overlap, total is {blob.total}")
        return data
