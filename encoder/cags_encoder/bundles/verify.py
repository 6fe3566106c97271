"""Checks a bundle from end to end."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from cags_common.bundle import BundlePlayer, BundleReader
from cags_common.errors import BundleError, DecodeError


def verify(reader: BundleReader, url: str, tell: Callable[[int, int], None]) -> int:
    """Check every CRC and decode everything; return the number of payloads.

    All layers of every tile are decoded, and every tile at LoD 0 as a client on a slow link gets it. Ids, counts and
    source frames must agree. Raises :class:`BundleError` naming the first damaged place.
    """
    manifest = reader.manifest
    top, base, payloads = BundlePlayer(reader), BundlePlayer(reader, 0), 0
    for index in range(manifest.frames):
        try:
            payloads += _verify_frame(reader, index, top, base)
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
    return payloads


def _verify_frame(reader: BundleReader, index: int, top: BundlePlayer, base: BundlePlayer) -> int:
    entry = reader.frame(index)
    for tile in entry.tiles:
        for lod in range(len(tile.lod_bytes)):
            reader.payload(index, tile.tile, lod)
        state = top.tile(index, tile)
        if len(state) != tile.splats:
            raise BundleError(
                f"frame {index}, tile {tile.tile}: has {len(state)} splats, but {tile.splats} in the index"
            )
    held, source = top.frame(index), reader.source(index)
    if not np.array_equal(held.ids, source.ids):
        raise BundleError(f"frame {index}: tiles and source frame disagree about the live splats")
    if not np.array_equal(base.frame(index).ids, held.ids):
        raise BundleError(f"frame {index}: LoD 0 and the highest LoD have different splats")
    if not all(np.isfinite(array).all() for _, array in held.splats.arrays()):
        raise BundleError(f"frame {index}: decodes to values that are not finite")
    return sum(len(tile.lod_bytes) for tile in entry.tiles) + 2
