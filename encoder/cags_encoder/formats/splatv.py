"""The ``.splatv`` container of antimatter15's splaTV: SpaceTime Gaussians as the texture uploaded by its viewer.

Two little-endian 32-bit words (0x674b, the length of the JSON that follows), a JSON list of chunks with ``type`` and
``size``, then the chunks one after another. The chunk ``splat`` holds 64 bytes a splat:

     0  position, 3 float32             28  RGB and opacity, 4 bytes
    12  rotation wxyz, 4 halves         32  motion, 9 halves and one unused
    20  scale, 3 halves and one unused  52  omega, 4 halves
                                        60  centre and width in time, 2 halves

Records of zeros pad the last row. Layout: ``hybrid.js`` of https://github.com/antimatter15/splaTV
"""

from __future__ import annotations

import json
import struct
from typing import Any

import numpy as np

from cags_common.errors import SceneError
from cags_common.splats import SH_C0, Splats
from cags_encoder.formats.files import check_count, directed, log_of_scales, logit_of_bytes, quietly
from cags_encoder.formats.repair import DropBroken
from cags_encoder.formats.timed import TimedSplats, checked_times

SUFFIX = ".splatv"
MAGIC = 0x674B
MAX_JSON_BYTES = 1 << 20
MAX_CHUNKS = 64

HEAD = struct.Struct("<II")
RECORD = np.dtype(
    [
        ("mean", "<f4", 3),
        ("quat", "<f2", 4),
        ("scale", "<f2", 3),
        ("unused", "<f2"),
        ("rgba", "u1", 4),
        ("motion", "<f2", 9),
        ("unused_too", "<f2"),
        ("omega", "<f2", 4),
        ("time", "<f2", 2),
    ]
)


@quietly
def parse_splatv(data: bytes, source: str, drop: DropBroken | None = None) -> TimedSplats:
    """Splats from a file's bytes, times in clip lengths; ``source`` names it in errors. Raises :class:`SceneError`."""
    first, size = _splat_chunk(data, source)
    check_count(size // RECORD.itemsize, source)
    rows = np.frombuffer(data, RECORD, size // RECORD.itemsize, first)
    rows = rows[rows.view(np.uint64).reshape(len(rows), -1).any(axis=1)]
    check_count(len(rows), source)
    splats = Splats(
        means=rows["mean"].astype(np.float32),
        quats=directed(rows["quat"].astype(np.float32)),
        log_scales=log_of_scales(rows["scale"].astype(np.float32)),
        logit_opacities=logit_of_bytes(rows["rgba"][:, 3]),
        sh0=(rows["rgba"][:, :3].astype(np.float32) / np.float32(255.0) - np.float32(0.5)) / np.float32(SH_C0),
        sh_rest=np.zeros((len(rows), 0, 3), np.float32),
    )
    times = rows["time"].astype(np.float64)
    motion = rows["motion"].astype(np.float32).reshape(-1, 3, 3)
    timed = TimedSplats(splats, times[:, 0], times[:, 1], motion, rows["omega"].astype(np.float32))
    return checked_times(timed, source, drop)


def _splat_chunk(data: bytes, source: str) -> tuple[int, int]:
    """Offset and size of the splats, in bytes."""
    if len(data) < HEAD.size or HEAD.unpack_from(data)[0] != MAGIC:
        raise SceneError(f"{source}: is not a .splatv file (it begins with {bytes(data[:4])!r}); check the file's type")
    length = HEAD.unpack_from(data)[1]
    if length > MAX_JSON_BYTES or HEAD.size + length > len(data):
        raise SceneError(f"{source}: claims {length} bytes of JSON; it is cut short or not a .splatv file")
    offset = HEAD.size + length
    for kind, size in _chunks(data[HEAD.size : offset], source):
        if offset + size > len(data):
            raise SceneError(f"{source}: is cut short: chunk {kind!r} ends at byte {offset + size} of {len(data)}")
        if kind == "splat":
            if size % RECORD.itemsize:
                raise SceneError(f"{source}: its chunk of splats has {size} bytes, not a multiple of {RECORD.itemsize}")
            return offset, size
        offset += size
    raise SceneError(f"{source}: has no chunk 'splat'; this .splatv holds no splats")


def _chunks(text: bytes, source: str) -> list[tuple[str, int]]:
    """Type and size of each chunk, in order."""
    try:
        found: Any = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise SceneError(
            f"{source}: its list of chunks is not JSON ({str(error)[:60]}); the file is damaged"
        ) from error
    if not isinstance(found, list) or len(found) > MAX_CHUNKS:
        raise SceneError(f"{source}: its JSON must be a list of at most {MAX_CHUNKS} chunks; the file is damaged")
    chunks = []
    for chunk in found:
        kind, size = (chunk.get("type"), chunk.get("size")) if isinstance(chunk, dict) else (None, None)
        if not isinstance(kind, str) or type(size) is not int or size < 0:
            raise SceneError(f"{source}: chunk {str(chunk)[:60]!r} needs a type and a size; the file is damaged")
        chunks.append((kind, size))
    return chunks
