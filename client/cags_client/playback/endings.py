"""What ends a play, or keeps it from beginning, and what may be tried again."""

from __future__ import annotations

import math

from cags_client.settings import ClientSettings
from cags_common.bundle.manifest import Manifest
from cags_common.errors import NetworkError
from cags_common.runtime.memory import memory_mb
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

MOST_MB, UNKNOWN_MB = 4096.0, 4096.0
"""Largest memory that is given where the settings say nothing, and that of a machine that does not tell its own."""


def affordable(info: Manifest, settings: ClientSettings) -> Manifest:
    """``info``. Raises :class:`NetworkError` where a group of frames takes more memory than the viewer gives."""
    largest = max(info.capacity, default=0)
    if largest > settings.max_splats:
        raise NetworkError(
            f"the stream has groups of {largest} splats, and this client takes {settings.max_splats}; see --max-splats"
        )
    needed_mb = COPIES * largest * 4 * (14 + 3 * SH_REST_OF_DEGREE[info.sh_degree]) / 1e6
    given_mb = settings.max_memory_mb or min((memory_mb() or UNKNOWN_MB) / 2, MOST_MB)
    if needed_mb > given_mb:
        raise NetworkError(
            f"the stream has groups of {largest} splats, which take {math.ceil(needed_mb)} MB; this client gives "
            f"{math.floor(given_mb)}; see --max-memory-mb"
        )
    return info
