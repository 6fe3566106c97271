"""Splats that a client still shows where they were, though they have moved on to where nobody sees them.

What is sent is chosen by what is seen of the true scene. A splat that leaves the picture between two frames is seen
no more, so its change would never be sent, and the client would go on drawing it at its old place: a ghost. Until the
newest version of a splat, and the motion that it follows, are on their way, the splat therefore counts for as much as
when it was last seen.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cags_common.geometry import F32
from cags_server.scene.library import SceneLibrary
from cags_server.visibility.inventory import ClientInventory


class Lingering:
    """The splats of one client that were seen in a version which has been replaced since."""

    def __init__(self, library: SceneLibrary, visible_px: float) -> None:
        self._library, self._visible_px = library, visible_px
        self._gof = -1
        self._ids: NDArray[np.intp] = np.zeros(0, np.intp)
        self._values: F32 = np.zeros(0, np.float32)

    def __len__(self) -> int:
        return len(self._ids)

    def added_to(self, contribution: F32, frame: int) -> F32:
        """``contribution`` [capacity] at ``frame``, and for those that linger at least what they had."""
        if not len(self._ids) or self._library.manifest.gof_of(frame) != self._gof:
            return contribution
        out = contribution.copy()
        out[self._ids] = np.maximum(out[self._ids], self._values)
        return out

    def update(self, contribution: F32, frame: int, inventory: ClientInventory) -> None:
        """After ``frame`` was planned: what was or had been seen, and is neither held nor on its way, lingers."""
        seen = self.added_to(contribution, frame)
        ids = np.flatnonzero(seen > self._visible_px)
        numbers, where = np.unique(self._library.owners(frame)[ids], return_inverse=True)
        tiles = self._library.tile_map(frame)
        chunks = tiles.chunk_at(numbers, frame)
        lacks = [n >= 0 and not inventory.depth(*tiles.key(n)) for n in numbers.tolist()]
        stands = [n >= 0 and not inventory.depth(*tiles.key(n)) for n in chunks.tolist()]
        stale = (np.array(lacks, bool) | np.array(stands, bool)) & (numbers >= 0)
        ids = ids[stale[where]] if len(ids) else ids
        self._gof, self._ids, self._values = self._library.manifest.gof_of(frame), ids, seen[ids]
