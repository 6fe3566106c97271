"""Arrays of an ``.npz`` archive from outside: no pickles, and nothing is allocated that the bytes at hand do not hold.

``numpy.load`` allocates what an entry's header claims before it reads the entry: a kilobyte can ask for gigabytes.
"""

from __future__ import annotations

import io
import math
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cags_common.errors import DecodeError

MAX_ARRAYS = 256
_HEADER_READERS = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}


def read_npz(data: bytes, limit_bytes: int) -> dict[str, NDArray[Any]]:
    """The arrays of an archive by name, at most ``limit_bytes`` of them. Raises :class:`DecodeError`."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            entries = archive.infolist()
            if len(entries) > MAX_ARRAYS or sum(entry.file_size for entry in entries) > limit_bytes:
                raise DecodeError(f"unpacks to too much: more than {MAX_ARRAYS} arrays or {limit_bytes} bytes")
            return {entry.filename.removesuffix(".npy"): _array(archive.read(entry)) for entry in entries}
    except (OSError, ValueError, EOFError, RuntimeError, zipfile.BadZipFile, zlib.error) as error:
        raise DecodeError(f"is no archive of arrays ({error})") from error


def load_npz(path: Path, limit_bytes: int) -> dict[str, NDArray[Any]]:
    """:func:`read_npz` of a file of at most ``limit_bytes``. Raises ``OSError`` and :class:`DecodeError`."""
    with path.open("rb") as file:
        data = file.read(limit_bytes + 1)
    if len(data) > limit_bytes:
        raise DecodeError(f"is larger than {limit_bytes} bytes")
    return read_npz(data, limit_bytes)


def _array(raw: bytes) -> NDArray[Any]:
    stream = io.BytesIO(raw)
    version = np.lib.format.read_magic(stream)
    if version not in _HEADER_READERS:
        raise ValueError(f"array of format {version}")
    shape, fortran, dtype = _HEADER_READERS[version](stream)
    start = stream.tell()
    if dtype.hasobject or math.prod(shape) * dtype.itemsize != len(raw) - start:
        raise ValueError(f"array of shape {shape} and type {dtype} in {len(raw) - start} bytes")
    return np.frombuffer(raw, dtype, offset=start).reshape(shape, order="F" if fortran else "C").copy()
