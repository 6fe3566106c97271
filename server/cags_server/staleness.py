"""For how long a client has been shown an older version of a tile's splats.

Where the media replaces everything in every frame and the link carries a part of it, what is worth most is what has
been stale for longest. Judged by this frame alone, the same tile would win every time, and the others never come.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from cags_server.library import SceneLibrary


class Staleness:
    """For one client and one group of frames: the frame whose version of each splat it holds, or is being sent."""

    def __init__(self, library: SceneLibrary) -> None:
        self._library = library
        self.clear()

    def clear(self) -> None:
        """The client holds nothing."""
        self._gof = -1
        self._claimed: tuple[tuple[int, int], ...] = ()
        self._arrived = self._sent = np.zeros(0, np.int32)  # [capacity] media frame

    def held(self, tiles: Iterable[tuple[int, int]]) -> None:
        """The client says that it holds these (media frame, tile) of an earlier session.

        They are looked up when their group begins, and what the bundle does not have is passed over.
        """
        self._claimed = tuple(tiles)

    def sent(self, frame: int, tile: int) -> None:
        """The splats of a tile were queued, in their version of ``frame``."""
        if self._enters(frame):
            ids = self._library.tile_ids(frame, tile)
            self._sent[ids] = np.maximum(self._sent[ids], frame)

    def settled(self, frame: int, tile: int, *, delivered: bool) -> None:
        """They have arrived, or will not."""
        if self._library.manifest.gof_of(frame) != self._gof:
            return
        ids = self._library.tile_ids(frame, tile)
        if delivered:
            self._arrived[ids] = np.maximum(self._arrived[ids], frame)
        else:
            self._sent[ids] = np.where(self._sent[ids] == frame, self._arrived[ids], self._sent[ids])

    def frames(self, at: int, frame: int, tile: int) -> float:
        """Frames for which the splats of a tile will have been stale when frame ``at`` is displayed, in the mean.

        1 at least: the tile is the next version of what the client holds.
        """
        ids = self._library.tile_ids(frame, tile)
        if not len(ids) or not self._enters(frame):
            return 1.0
        return max(at - float(self._sent[ids].mean()), 1.0)

    def _enters(self, frame: int) -> bool:
        """Begin the group of ``frame`` if it is a later one; whether ``frame`` is of this group now.

        What a client was shown before a group begins is of the frame before it, at best.
        """
        manifest = self._library.manifest
        gof = manifest.gof_of(frame)
        if gof > self._gof:
            self._gof = gof
            self._arrived = np.full(manifest.capacity[gof], manifest.gof_starts[gof] - 1, np.int32)
            for key in self._held_of(gof):
                ids = self._library.tile_ids(*key)
                self._arrived[ids] = np.maximum(self._arrived[ids], key[0])
            self._sent = self._arrived.copy()
        return gof == self._gof

    def _held_of(self, gof: int) -> list[tuple[int, int]]:
        frames = self._library.manifest.gof_frames(gof)
        claimed = [(frame, tile) for frame, tile in self._claimed if frame in frames]
        return [(frame, tile) for frame, tile in claimed if tile < len(self._library.entry(frame).tiles)]
