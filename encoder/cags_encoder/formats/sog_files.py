"""Files of a SOG data set from a folder or zip, each with a size limit that is checked before decoding."""

from __future__ import annotations

import io
import json
import struct
import zipfile
import zlib
from pathlib import Path
from typing import BinaryIO, Protocol

import numpy as np
from numpy.typing import NDArray

from cags_common.errors import SceneError
from cags_encoder.formats.files import read_file

MAX_META_BYTES = 1 << 20
MAX_IMAGE_BYTES = 256 << 20
MAX_ENTRIES = 64
"""Files in a zip; a data set has at most eight."""

SLACK_PIXELS = 1 << 16
"""Allowed number of image pixels beyond twice the splat count: writers round the sides up."""

ZIP_FAULTS = (
    zipfile.BadZipFile,
    zlib.error,
    NotImplementedError,
    RuntimeError,
    ValueError,
    EOFError,
    OSError,
    struct.error,
    KeyError,
)
"""Exceptions of :mod:`zipfile` for damaged archives."""

_IMAGE_FAULTS = (
    OSError,
    ValueError,
    SyntaxError,
    EOFError,
    struct.error,
    TypeError,
    IndexError,
    KeyError,
    OverflowError,
)


MAX_QUOTED_CHARS = 120
"""Longest quotation of what a library says of a damaged file."""


def in_words(error: Exception) -> str:
    """What a library says of a damaged file, on one line: some quote kilobytes of it, some say nothing."""
    said = next(iter(str(error).splitlines()), type(error).__name__)
    return said if len(said) <= MAX_QUOTED_CHARS else f"{said[:MAX_QUOTED_CHARS]}…"


class _Store(Protocol):
    def read(self, name: str, max_bytes: int) -> bytes: ...


class FolderStore:
    """Files in a folder."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def read(self, name: str, max_bytes: int) -> bytes:
        """The bytes of one file."""
        return read_file(self._folder / name, max_bytes)


class ZipStore:
    """Entries at the root of a zip archive. Raises :class:`SceneError` if the file is not a zip."""

    def __init__(self, file: BinaryIO, source: str) -> None:
        self._source = source
        try:
            self._archive = zipfile.ZipFile(file)
        except ZIP_FAULTS as error:
            raise SceneError(
                f"{source}: is not a zip archive or is damaged ({in_words(error)}); check the file's type"
            ) from error
        self._entries = {info.filename: info for info in self._archive.infolist()[: MAX_ENTRIES + 1]}
        if len(self._entries) > MAX_ENTRIES:
            raise SceneError(f"{source}: holds over {MAX_ENTRIES} files; this is not a SOG bundle")

    def read(self, name: str, max_bytes: int) -> bytes:
        """The bytes of one entry. At most ``max_bytes`` are inflated."""
        info = self._entries.get(name)
        if info is None:
            raise SceneError(f"{self._source}: lacks {name}; the SOG bundle is incomplete")
        try:
            with self._archive.open(info) as entry:
                data = entry.read(max_bytes + 1)
        except ZIP_FAULTS as error:
            raise SceneError(f"{self._source}: {name} is damaged ({in_words(error)}); fetch the file again") from error
        if len(data) > max_bytes:
            raise SceneError(f"{self._source}: {name} is over {max_bytes} bytes long")
        return data


class SogFiles:
    """Decoded files of one data set; ``source`` names it in errors."""

    def __init__(self, store: _Store, source: str) -> None:
        self._store, self.source = store, source

    @classmethod
    def from_bytes(cls, data: bytes, source: str) -> SogFiles:
        """A bundled data set (``.sog``)."""
        return cls(ZipStore(io.BytesIO(data), source), source)

    @classmethod
    def from_folder(cls, folder: Path) -> SogFiles:
        """An unbundled data set: a folder with ``meta.json``."""
        return cls(FolderStore(folder), str(folder))

    def json(self, name: str) -> object:
        """A parsed JSON file."""
        data = self._store.read(name, MAX_META_BYTES)
        try:
            return json.loads(data)
        except (ValueError, RecursionError) as error:
            raise SceneError(f"{self.source}: {name} is not JSON ({error})") from error

    def size(self, name: str) -> tuple[int, int]:
        """Width and height of an image, pixels, without decoding it."""
        width, height, _ = self._open(name, decode=False, max_pixels=0)
        return width, height

    def image(self, name: str, max_pixels: int) -> NDArray[np.uint8]:
        """An image [H, W, 4] RGBA of at most ``max_pixels``, plus what writers add by rounding up."""
        return self._open(name, decode=True, max_pixels=max_pixels)[2]

    def texels(self, name: str, count: int) -> NDArray[np.uint8]:
        """The first ``count`` pixels [count, 4] RGBA of an image, row by row."""
        pixels = self.image(name, count).reshape(-1, 4)
        if len(pixels) < count:
            raise SceneError(f"{self.source}: {name} has {len(pixels)} pixels for {count} splats; the file is damaged")
        return pixels[:count]

    def _open(self, name: str, *, decode: bool, max_pixels: int) -> tuple[int, int, NDArray[np.uint8]]:
        from PIL import Image  # slow import that only this format needs

        data = self._store.read(name, MAX_IMAGE_BYTES)
        try:
            with Image.open(io.BytesIO(data), formats=("WEBP", "PNG")) as image:
                width, height = image.size
                if decode and width * height > 2 * max_pixels + SLACK_PIXELS:
                    raise SceneError(f"{self.source}: {name} is {width}x{height} px, too large for {max_pixels} values")
                pixels = np.asarray(image.convert("RGBA")) if decode else np.zeros((0, 0, 4), np.uint8)
        except (*_IMAGE_FAULTS, Image.DecompressionBombError, Image.DecompressionBombWarning) as error:
            raise SceneError(f"{self.source}: {name} is not a readable image ({in_words(error)})") from error
        return width, height, pixels
