"""Bounds of the wire protocol: each is checked before anything of that size is allocated."""

from __future__ import annotations

PROTOCOL_VERSION = 4
"""Version spoken by this package. A change that an older peer cannot ignore raises it."""

SUPPORTED_VERSIONS = (4,)
"""Versions that this package can talk to."""

SUBPROTOCOL = "cags.v1"
"""WebSocket subprotocol name, of the framing: all versions share it, so that a session can refuse the others by name.
"""

PACKET_BYTES = 8192
"""Size of the largest packet a server writes: a message is cut into fragments of this size, header included."""

MAX_HEADER_BYTES = 64 * 1024
"""Longest MessagePack header of a message."""

MAX_CLIENT_MESSAGE_BYTES = 128 * 1024
"""Longest message a client may send (a Hello that resumes with a full inventory is the longest)."""

MAX_MESSAGE_BYTES = 16 * 1024 * 1024
"""Longest reassembled message a server may send."""

MAX_BLOB_BYTES = 256 * 1024 * 1024
"""Longest blob (codebooks, network weights) over all of its chunks."""

BLOB_CHUNK_BYTES = 256 * 1024
"""Size of the chunks into which :func:`cags_protocol.sessions.blobs.blob_chunks` cuts a blob."""

MAX_PARTIAL_MESSAGES = 64
"""Messages that a client keeps half received; a server starts at most half as many."""

MAX_PARTIAL_BYTES = 32 * 1024 * 1024
"""Bytes of half-received messages that a client keeps."""

MAX_POSE_SAMPLES = 64
"""Pose samples in one batch."""

MAX_ACK_RANGES = 32
"""Ranges of packet numbers in one acknowledgement, newest first."""

MAX_EVICTED_TILES = 512
"""Tiles in one acknowledgement's list of what the store dropped."""

MAX_TEXT_BYTES = 1024
"""Longest text field."""
