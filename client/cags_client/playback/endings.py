"""What ends a play, or keeps it from beginning, and what may be tried again."""

from __future__ import annotations

from cags_client.settings import ClientSettings
from cags_common.bundle.manifest import Manifest
from cags_common.errors import NetworkError
from cags_common.splats import SH_REST_OF_DEGREE
from cags_protocol.wire.messages import Refusal, RefusalCode

FATAL_REFUSALS = frozenset(RefusalCode) - {RefusalCode.FULL, RefusalCode.TIMEOUT, RefusalCode.INTERNAL}
"""Refusals that another attempt would only meet again; any other code may be gone a moment later."""

FATAL_ENDS = frozenset({"malformed", "unexpected"})
"""Ends of a session by a breach of the protocol: the same would follow again."""


def refused(refusal: Refusal) -> NetworkError:
    """A server's refusal as an error."""
    where = f" ({refusal.field})" if refusal.field else ""
    return NetworkError(f"the server refused{where}: {refusal.message}")


COPIES = 4.5
"""Times that the memory of a group's splats is taken at most: merged and in the renderer, two groups at a border."""


def affordable(info: Manifest, settings: ClientSettings) -> Manifest:
    """``info``. Raises :class:`NetworkError` where a group of frames takes more memory than the viewer gives."""
    largest = max(info.capacity, default=0)
    if largest > settings.max_splats:
        raise NetworkError(
            f"the stream has groups of {largest} splats, and this client takes {settings.max_splats}; see --max-splats"
        )
    needed_mb = COPIES * largest * 4 * (14 + 3 * SH_REST_OF_DEGREE[info.sh_degree]) / 1e6
    if needed_mb > settings.max_memory_mb:
        raise NetworkError(
            f"the stream has groups of {largest} splats, which take {needed_mb:.0f} MB; this client gives "
            f"{settings.max_memory_mb:g}; see --max-memory-mb"
        )
    return info
