"""What ends a play, or keeps it from beginning, and what may be tried again."""

from __future__ import annotations

from cags_common.bundle.manifest import Manifest
from cags_common.errors import NetworkError
from cags_protocol.messages import Refusal, RefusalCode

FATAL_REFUSALS = frozenset(RefusalCode) - {RefusalCode.FULL, RefusalCode.TIMEOUT, RefusalCode.INTERNAL}
"""Refusals that another attempt would only meet again; any other code may be gone a moment later."""

FATAL_ENDS = frozenset({"malformed", "unexpected"})
"""Ends of a session by a breach of the protocol: the same would follow again."""


def refused(refusal: Refusal) -> NetworkError:
    """A server's refusal as an error."""
    where = f" ({refusal.field})" if refusal.field else ""
    return NetworkError(f"the server refused{where}: {refusal.message}")


def affordable(info: Manifest, most: int) -> Manifest:
    """``info``. Raises :class:`NetworkError` where a group of frames takes more memory than the viewer gives."""
    largest = max(info.capacity, default=0)
    if largest > most:
        raise NetworkError(f"the stream has groups of {largest} splats, and this client takes {most}; see --max-splats")
    return info
