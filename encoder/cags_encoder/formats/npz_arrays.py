"""Arrays of an ``.npz`` archive, with size limits and without pickles. Uncompressed arrays are memory-mapped.

Archives of dynamic scenes hold gigabytes, of which one frame needs megabytes. ``np.savez`` stores arrays uncompressed,
so a frame's slice can be read in place. Deflated arrays are inflated whole, up to :data:`MAX_INFLATED_BYTES` for the
archive, and only after their header has shown the expected shape.
"""

from __future__ import annotations

import math
import re
import struct
import zipfile
from pathlib import Path
from typing import IO, Any, BinaryIO, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cags_common.errors import SceneError
from cags_encoder.formats.sog_files import MAX_ENTRIES, ZIP_FAULTS, in_words

MAX_INFLATED_BYTES = 1 << 30
"""Limit for all deflated arrays of an archive together. Memory-mapped arrays may be of any size."""

INFLATED_AT_ONCE = 1 << 20
MAX_NPY_HEADER = 10_000

_LOCAL_HEADER = struct.Struct("<4s22xHH")
_MAGIC = struct.Struct("<6sBx")
_HEADER = re.compile(
    rb"\A\{'descr': '([<>|=][a-zA-Z][0-9]{0,3})', 'fortran_order': (True|False), "
    rb"'shape': \(((?:[0-9]{1,12}(?:, ?|(?=\))))*)\), \}\s*\Z"
)


class _Header(NamedTuple):
    shape: tuple[int, ...]
    fortran: bool
    dtype: np.dtype[np.floating[Any]]

    @property
    def order(self) -> Literal["F", "C"]:
        return "F" if self.fortran else "C"


class NpzArrays:
    """Numeric arrays of an archive by name. Raises :class:`SceneError` if the file is not an archive of numbers."""

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            with zipfile.ZipFile(path) as archive:
                entries = archive.infolist()
        except FileNotFoundError as error:
            raise SceneError(f"{path}: cannot be read ({error.strerror}); give an existing file") from error
        except ZIP_FAULTS as error:
            raise SceneError(f"{path}: is not an .npz archive or is damaged ({in_words(error)})") from error
        if len(entries) > MAX_ENTRIES:
            raise SceneError(f"{path}: holds over {MAX_ENTRIES} arrays; this is not the params.npz of a dynamic scene")
        self._inflated_bytes = 0
        self._entries = {entry.filename.removesuffix(".npy"): entry for entry in entries}

    def __contains__(self, name: str) -> bool:
        return name in self._entries

    def array(self, name: str, width: int | None = None) -> NDArray[np.floating[Any]]:
        """The floating-point array ``name``, memory-mapped if it is stored uncompressed.

        If ``width`` is given, the shape must be [N, width] or [T, N, width]; it is checked before anything is inflated.
        """
        entry = self._entries.get(name)
        if entry is None:
            raise SceneError(f"{self._path}: lacks the array {name!r}; this is not the params.npz of a dynamic scene")
        try:
            if entry.compress_type == zipfile.ZIP_STORED:
                return self._mapped(name, entry, width)
            return self._inflated(name, entry, width)
        except ZIP_FAULTS as error:
            raise SceneError(f"{self._path}: the array {name!r} is damaged ({in_words(error)})") from error

    def _mapped(self, name: str, entry: zipfile.ZipInfo, width: int | None) -> NDArray[np.floating[Any]]:
        with self._path.open("rb") as file:
            file.seek(entry.header_offset)
            _, name_length, extra_length = _LOCAL_HEADER.unpack(file.read(_LOCAL_HEADER.size))
            start = entry.header_offset + _LOCAL_HEADER.size + name_length + extra_length
            file.seek(start)
            header = self._header(name, file)
            offset = file.tell()
        self._check(name, header, entry.file_size - (offset - start), width)
        if math.prod(header.shape) == 0:  # an empty array cannot be mapped
            return np.zeros(header.shape, header.dtype)
        return np.memmap(
            self._path, dtype=header.dtype, mode="r", offset=offset, shape=header.shape, order=header.order
        )

    def _inflated(self, name: str, entry: zipfile.ZipInfo, width: int | None) -> NDArray[np.floating[Any]]:
        self._inflated_bytes += entry.file_size
        if self._inflated_bytes > MAX_INFLATED_BYTES:
            raise SceneError(
                f"{self._path}: its arrays up to {name!r} inflate to over {MAX_INFLATED_BYTES} bytes; "
                "save the file without compression (numpy.savez)"
            )
        with zipfile.ZipFile(self._path) as archive, archive.open(entry) as file:
            header = self._header(name, file)
            self._check(name, header, entry.file_size - file.tell(), width)
            flat = np.empty(math.prod(header.shape), header.dtype)
            room, at = flat.view(np.uint8).data, 0
            while at < len(room):
                count = file.readinto(room[at : at + INFLATED_AT_ONCE])  # type: ignore[attr-defined]
                if not count:
                    raise SceneError(f"{self._path}: the array {name!r} is cut short: it has {at} of {len(room)} bytes")
                at += count
        return flat.reshape(header.shape, order=header.order)

    def _header(self, name: str, file: BinaryIO | IO[bytes]) -> _Header:
        """The ``.npy`` header, matched against what numpy writes for plain arrays. Nothing in it is evaluated."""
        magic, major = _MAGIC.unpack(file.read(_MAGIC.size))
        if magic != b"\x93NUMPY" or major not in (1, 2, 3):
            raise SceneError(f"{self._path}: the array {name!r} is not an .npy file (it begins with {magic!r})")
        (length,) = struct.unpack(*(("<H", file.read(2)) if major == 1 else ("<I", file.read(4))))
        match = _HEADER.match(file.read(length)) if length <= MAX_NPY_HEADER else None
        if match is None:
            raise SceneError(f"{self._path}: the array {name!r} has an unknown header; save it with numpy")
        kind, fortran, sides = (group.decode("ascii") for group in match.groups())
        if kind[1:] not in ("f2", "f4", "f8"):
            raise SceneError(f"{self._path}: the array {name!r} holds {kind!r}, not floating-point numbers")
        shape = tuple(int(side) for side in sides.split(",") if side.strip())
        return _Header(shape, fortran == "True", np.dtype(kind))

    def _check(self, name: str, header: _Header, room: int, width: int | None) -> None:
        """Check that the header's shape is as expected and fits into ``room`` bytes."""
        shape = header.shape
        if width is not None and (len(shape) not in (2, 3) or shape[-1] != width):
            raise SceneError(f"{self._path}: {name} has shape {shape}, expected [T, N, {width}] or [N, {width}]")
        if math.prod(shape) * header.dtype.itemsize > room or max(shape, default=0) > room:
            raise SceneError(f"{self._path}: the array {name!r} of shape {shape} is cut short: it has {room} bytes")
