"""Every tile of one group of frames by number, and which chunk of motion a tile of looks follows at a frame.

Numbers go through the group, frame by frame and tile by tile: a larger one is as new or newer. Everything here is read
from the bundle's index; no payload is touched.
"""

from __future__ import annotations

from itertools import accumulate

import numpy as np
from numpy.typing import NDArray

from cags_common.bundle import FrameEntry
from cags_common.errors import BundleError
from cags_common.geometry import F64
from cags_common.tiles.kinds import TileKind

Key = tuple[int, int]
"""Media frame and tile."""

Numbers = NDArray[np.int32]


class TileMap:
    """The tiles of one group of frames, numbered in order of frames. Immutable."""

    def __init__(self, entries: list[FrameEntry]) -> None:
        """``entries``: the group's frames in order. Raises :class:`BundleError` for motion of looks that it lacks."""
        tiles = [(entry.frame, tile) for entry in entries for tile in entry.tiles]
        self.start = entries[0].frame
        self.firsts = tuple(accumulate((len(entry.tiles) for entry in entries[:-1]), initial=0))
        """Number of the first tile of each frame."""
        new = (sum(tile.splats for tile in entry.tiles if tile.kind == TileKind.LOOKS) for entry in entries)
        self._splats = tuple(accumulate(new))
        self.frames: Numbers = np.array([frame for frame, _ in tiles], np.int32)
        self.tiles: Numbers = np.array([tile.tile for _, tile in tiles], np.int32)
        self.kinds: NDArray[np.uint8] = np.array([tile.kind for _, tile in tiles], np.uint8)
        self.bounds: F64 = np.array([tile.bounds for _, tile in tiles], np.float64).reshape(-1, 2, 3)
        """[tiles, 2, 3] smallest and largest corner of each tile, world, metres; of motion, over its whole span."""
        self.has_updates = bool((self.kinds == TileKind.UPDATE).any())
        self.looks = self._looks(entries)
        """[tiles] number of the looks that a tile of motion moves; -1 for other kinds."""
        self._period = len(entries)
        moving = np.flatnonzero(self.kinds == TileKind.MOTION).astype(np.int32)
        keys = self._place(self.looks[moving], self.frames[moving])
        order = np.argsort(keys, kind="stable")
        self._chunks, self._keys = moving[order], keys[order]  # by looks, then by first frame

    def __len__(self) -> int:
        return len(self.frames)

    def number(self, frame: int, tile: int) -> int:
        """The number of a tile of ``frame``, a frame of the group."""
        return self.firsts[frame - self.start] + tile

    def new_splats(self, frame: int, later: int) -> int:
        """Splats of all looks of the frames after ``frame`` up to ``later``, two frames of the group in order."""
        return self._splats[later - self.start] - self._splats[frame - self.start]

    def key(self, number: int) -> Key:
        """(media frame, tile) of a number."""
        return int(self.frames[number]), int(self.tiles[number])

    def has(self, key: Key) -> bool:
        """Whether ``key`` is a tile of the group."""
        row = key[0] - self.start
        if not 0 <= row < len(self.firsts):
            return False
        end = self.firsts[row + 1] if row + 1 < len(self.firsts) else len(self)
        return 0 <= key[1] < end - self.firsts[row]

    def chunk_at(self, looks: Numbers, frame: int) -> Numbers:
        """[m] the newest motion that begins at or before ``frame`` of each tile of ``looks`` [m]; -1: none."""
        return self._chunk(looks, np.searchsorted(self._keys, self._place(looks, frame), side="right") - 1)

    def chunk_after(self, looks: Numbers, frame: Numbers | int) -> Numbers:
        """[m] the first motion that begins after ``frame`` ([m] or one) of each tile of ``looks`` [m]; -1: none."""
        return self._chunk(looks, np.searchsorted(self._keys, self._place(looks, frame), side="right"))

    def chunks_until(self, looks: int, frame: int) -> list[int]:
        """All motion of one tile of looks that begins at or before ``frame``, newest first."""
        first, end = np.searchsorted(self._keys, [self._place(looks, self.start), self._place(looks, frame) + 1])
        return [int(number) for number in self._chunks[first:end][::-1]]

    def _chunk(self, looks: Numbers, rows: NDArray[np.intp]) -> Numbers:
        inside = (rows >= 0) & (rows < len(self._chunks))
        found = np.full(len(looks), -1, np.int32)
        found[inside] = self._chunks[rows[inside]]
        found[found >= 0] = np.where(self.looks[found] == looks, found, -1)[found >= 0]
        return found

    def _place(self, looks: Numbers | int, frame: Numbers | int) -> NDArray[np.int64]:
        """Where motion of ``looks`` from ``frame`` on stands among all chunks."""
        return np.asarray(looks, np.int64) * self._period + (np.asarray(frame, np.int64) - self.start)

    def _looks(self, entries: list[FrameEntry]) -> Numbers:
        out = np.full(len(self), -1, np.int32)
        for entry, first in zip(entries, self.firsts, strict=True):
            for tile in entry.tiles:
                if tile.looks is None:
                    continue
                if not self.has(tile.looks) or tile.looks[0] > entry.frame:
                    raise BundleError(f"frame {entry.frame}, tile {tile.tile}: moves {tile.looks}, which is not there")
                out[first + tile.tile] = self.number(*tile.looks)
        return out
