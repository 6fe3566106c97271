"""Checks a bundle from end to end."""

from __future__ import annotations

import io
from collections.abc import Callable

import numpy as np

from cags_common.bundle import BundlePlayer, BundleReader
from cags_common.bundle.index import FrameEntry
from cags_common.errors import BundleError, DecodeError
from cags_common.splats import Ids
from cags_common.tiles.kinds import TileKind


def verify(reader: BundleReader, url: str, tell: Callable[[int, int], None]) -> int:
    """Check every CRC and decode everything; return the number of payloads.

    All layers of every tile are decoded, and every tile at LoD 0 as a client on a slow link gets it. Ids, counts and
    source frames must agree; where levels add splats, LoD 0 may have fewer. Raises :class:`BundleError` naming the
    first damaged place.
    """
    manifest = reader.manifest
    frames, payloads = _Frames(reader), 0
    for index in range(manifest.frames):
        try:
            payloads += frames.verify(index)
        except (BundleError, DecodeError) as error:
            text = str(error)
            raise BundleError(f"{url}: {text if 'frame' in text else f'frame {index}: {text}'}") from error
        tell(index + 1, manifest.frames)
    try:
        quality = reader.quality()
    except BundleError as error:
        raise BundleError(f"{url}: {error}") from error
    if quality is not None and len(quality.ladder) != manifest.lods:
        raise BundleError(f"{url}: quality.json has {len(quality.ladder)} levels, the manifest {manifest.lods}")
    _verify_thumbnail(reader, url)
    return payloads


def _verify_thumbnail(reader: BundleReader, url: str) -> None:
    """Decode what galleries show, where there is any. Raises :class:`BundleError`."""
    from PIL import Image

    data = reader.thumbnail()
    if data is None:
        return
    try:
        with Image.open(io.BytesIO(data), formats=("JPEG",)) as image:
            image.load()
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise BundleError(f"{url}: thumbnail.jpg: is damaged; store one anew by cags-encode --set-view") from error


class _Frames:
    """The frames of a bundle at the highest LoD and at LoD 0, side by side, in rising order."""

    def __init__(self, reader: BundleReader) -> None:
        self._reader, self._top, self._base = reader, BundlePlayer(reader), BundlePlayer(reader, 0)
        self._growing: set[int] = set()
        """Ids that LoD 0 may lack: those of tiles to which further levels add splats, in this group of frames."""

    def verify(self, index: int) -> int:
        """Check one frame; return the number of its payloads. Raises :class:`BundleError` or :class:`DecodeError`."""
        entry = self._reader.frame(index)
        for tile in entry.tiles:
            for lod in range(len(tile.lod_bytes)):
                self._reader.payload(index, tile.tile, lod)
            state = self._top.tile(index, tile)
            if len(state) != tile.splats:
                raise BundleError(
                    f"frame {index}, tile {tile.tile}: has {len(state)} splats, but {tile.splats} in the index"
                )
        held, source = self._top.frame(index), self._reader.source(index)
        if not np.array_equal(held.ids, source.ids):
            raise BundleError(f"frame {index}: tiles and source frame disagree about the live splats")
        self._verify_base(index, entry, held.ids)
        if not all(np.isfinite(array).all() for _, array in held.splats.arrays()):
            raise BundleError(f"frame {index}: decodes to values that are not finite")
        return sum(len(tile.lod_bytes) for tile in entry.tiles) + 2

    def _verify_base(self, index: int, entry: FrameEntry, ids: Ids) -> None:
        """Compare the splats of LoD 0 with ``ids`` [n], those of the highest LoD."""
        if entry.keyframe:
            self._growing.clear()
        base = self._base.frame(index).ids
        lacking = set(np.setdiff1d(ids, base).tolist())
        if not lacking <= self._growing:  # of earlier tiles it is known, so the rest is of this frame's
            self._growing |= self._growing_ids(index, entry)
        if not lacking <= self._growing or len(np.setdiff1d(base, ids)):
            raise BundleError(f"frame {index}: LoD 0 and the highest LoD have different splats")

    def _growing_ids(self, index: int, entry: FrameEntry) -> set[int]:
        """Ids of all splats of the tiles of one frame to which levels after LoD 0 may add splats."""
        found: set[int] = set()
        for tile in entry.tiles:
            if tile.kind == TileKind.LOOKS and getattr(self._base.tile(index, tile), "grows", False):
                found.update(self._reader.codec.tile_ids(self._reader.payload(index, tile.tile, 0)).tolist())
        return found
