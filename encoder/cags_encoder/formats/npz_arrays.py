"""Arrays of an ``.npz`` archive, bounded and without pickles; stored arrays are mapped, not read.

Archives of dynamic scenes hold gigabytes of which a frame needs megabytes: ``np.savez`` stores arrays uncompressed, so
that a frame's slice is read where it lies. Deflated archives are inflated whole, within :data:`MAX_INFLATED_BYTES`.
"""

from __future__ import annotations

import io
import math
import struct
import zipfile
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from cags_common.errors import SceneError
from cags_encoder.formats.sog_files import MAX_ENTRIES, ZIP_FAULTS

MAX_INFLATED_BYTES = 4 << 30
MAX_NPY_HEADER = 10_000
"""Characters of an array's header; numpy reads it as literals, never as code."""

_LOCAL_HEADER = struct.Struct("<4s22xHH")
_NPY_FAULTS = (*ZIP_FAULTS, SyntaxError, TypeError, RecursionError, MemoryError, UnicodeDecodeError, OverflowError)


class NpzArrays:
    """Numeric arrays of an archive by name. Raises :class:`SceneError` for what is no archive of numbers."""

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            with zipfile.ZipFile(path) as archive:
                entries = archive.infolist()
        except FileNotFoundError as error:
            raise SceneError(f"{path}: cannot be read ({error.strerror}); give an existing file") from error
        except ZIP_FAULTS as error:
            raise SceneError(f"{path}: is not an .npz archive or is damaged ({error})") from error
        if len(entries) > MAX_ENTRIES:
            raise SceneError(f"{path}: holds over {MAX_ENTRIES} arrays; this is no params.npz of a dynamic scene")
        self._entries = {entry.filename.removesuffix(".npy"): entry for entry in entries}

    def __contains__(self, name: str) -> bool:
        return name in self._entries

    def array(self, name: str) -> NDArray[np.floating[Any]]:
        """The array ``name``, of floating-point numbers; mapped from the file where it is stored uncompressed."""
        entry = self._entries.get(name)
        if entry is None:
            raise SceneError(f"{self._path}: lacks the array {name!r}; this is no params.npz of a dynamic scene")
        try:
            if entry.compress_type == zipfile.ZIP_STORED:
                return self._mapped(name, entry)
            return self._inflated(name, entry)
        except _NPY_FAULTS as error:
            reason = str(error).splitlines()[0] if str(error) else type(error).__name__
            raise SceneError(f"{self._path}: the array {name!r} is damaged ({reason})") from error

    def _mapped(self, name: str, entry: zipfile.ZipInfo) -> NDArray[np.floating[Any]]:
        with self._path.open("rb") as file:
            file.seek(entry.header_offset)
            _, name_length, extra_length = _LOCAL_HEADER.unpack(file.read(_LOCAL_HEADER.size))
            start = entry.header_offset + _LOCAL_HEADER.size + name_length + extra_length
            file.seek(start)
            shape, fortran, dtype = self._header(name, file)
            offset = file.tell()
        self._check(name, shape, dtype, entry.file_size - (offset - start))
        if math.prod(shape) == 0:  # nothing cannot be mapped
            return np.zeros(shape, dtype)
        order: Literal["F", "C"] = "F" if fortran else "C"
        return np.memmap(self._path, dtype=dtype, mode="r", offset=offset, shape=shape, order=order)

    def _inflated(self, name: str, entry: zipfile.ZipInfo) -> NDArray[np.floating[Any]]:
        if entry.file_size > MAX_INFLATED_BYTES:
            raise SceneError(f"{self._path}: the array {name!r} inflates to over {MAX_INFLATED_BYTES} bytes; store it")
        with zipfile.ZipFile(self._path) as archive, archive.open(entry) as file:
            data = file.read(entry.file_size + 1)
        stream = io.BytesIO(data)
        shape, fortran, dtype = self._header(name, stream)
        self._check(name, shape, dtype, len(data) - stream.tell())
        flat = np.frombuffer(data, dtype, math.prod(shape), stream.tell())
        return flat.reshape(shape, order="F" if fortran else "C")

    def _header(self, name: str, file: Any) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
        version = npy.read_magic(file)
        read = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
        shape, fortran, dtype = read(file, max_header_size=MAX_NPY_HEADER)
        if dtype.kind != "f":
            raise SceneError(f"{self._path}: the array {name!r} holds {dtype}, not floating-point numbers")
        return shape, fortran, dtype

    def _check(self, name: str, shape: tuple[int, ...], dtype: np.dtype[Any], room: int) -> None:
        """The claimed shape fits the bytes that are there."""
        if not all(0 <= side < 2**40 for side in shape) or math.prod(shape) * dtype.itemsize > room:
            raise SceneError(f"{self._path}: the array {name!r} of shape {shape} is cut short: {room} bytes are there")
