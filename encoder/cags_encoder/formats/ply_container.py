"""The PLY container: its text header and elements, shared by the formats built on it.

The layout follows Turk's description of PLY. Binary files of either byte order and text files are supported. List
properties are refused with their name; files of splats do not use them.
"""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cags_common.errors import SceneError

MAX_HEADER_BYTES = 1 << 16
MAX_ELEMENTS, MAX_PROPERTIES = 16, 512

_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
_TEXT = "ascii"
_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", _TEXT: "<"}
_COUNT = re.compile(r"\A[0-9]{1,12}\Z", re.ASCII)


@dataclass(frozen=True, slots=True)
class PlyElement:
    """One element: its name, the number of rows that the header gives, and the layout of a row."""

    name: str
    count: int
    properties: tuple[tuple[str, str], ...]  # name and numpy type

    @property
    def dtype(self) -> np.dtype[np.void]:
        """Packed record of one row."""
        return np.dtype(list(self.properties))


@dataclass(frozen=True, slots=True)
class PlyHeader:
    """Elements in file order, and where their rows begin."""

    elements: tuple[PlyElement, ...]
    body: int
    text: bool = False

    def element(self, name: str) -> PlyElement | None:
        """The element called ``name``, if the file has it."""
        return next((element for element in self.elements if element.name == name), None)


def parse_header(data: bytes, source: str) -> PlyHeader:
    """Parse the header at the start of ``data``; ``source`` names the file in errors. Raises :class:`SceneError`."""
    if re.match(rb"ply\r?(\n|\Z)", data) is None:
        raise SceneError(f"{source}: is not a PLY file (it begins with {bytes(data[:4])!r}); check the file's type")
    end = re.search(rb"\nend_header\r?\n", data[:MAX_HEADER_BYTES])
    if end is None:
        raise SceneError(
            f"{source}: its PLY header has no end_header line in {MAX_HEADER_BYTES} bytes; the file is cut short"
        )
    order, text, elements = "", False, list[PlyElement]()
    for line in data[: end.start()].decode("latin-1").splitlines()[1:]:
        words = line.split()
        match words:
            case [] | ["comment" | "obj_info", *_]:
                pass
            case ["format", kind, _] if kind in _ORDERS:
                order, text = _ORDERS[kind], kind == _TEXT
            case ["format", kind, *_]:
                raise SceneError(f"{source}: PLY format {kind!r} is not supported; convert it to binary_little_endian")
            case ["element", name, count] if _COUNT.match(count) and len(elements) < MAX_ELEMENTS:
                elements.append(PlyElement(name, int(count), ()))
            case ["property", kind, name] if kind in _TYPES and elements and order:
                elements[-1] = _with_property(elements[-1], name, order + _TYPES[kind], source)
            case _:
                raise SceneError(f"{source}: PLY header line {line[:80]!r} is not understood; is this a splat file?")
    return PlyHeader(tuple(elements), end.end(), text)


def _with_property(element: PlyElement, name: str, kind: str, source: str) -> PlyElement:
    if any(name == known for known, _ in element.properties):
        raise SceneError(f"{source}: property {name!r} appears twice in its PLY header; repair the file")
    if len(element.properties) >= MAX_PROPERTIES:
        raise SceneError(
            f"{source}: element {element.name!r} has over {MAX_PROPERTIES} properties; is this a splat file?"
        )
    return PlyElement(element.name, element.count, (*element.properties, (name, kind)))


def read_rows(data: bytes, header: PlyHeader, source: str) -> dict[str, NDArray[np.void]]:
    """Rows of each element: views of ``data`` unless it is text. Raises :class:`SceneError` for truncated files."""
    if header.text:
        return _text_rows(data, header, source)
    rows: dict[str, NDArray[np.void]] = {}
    offset = header.body
    for element in header.elements:
        size = element.count * element.dtype.itemsize
        if offset + size > len(data):
            raise SceneError(
                f"{source}: is cut short: element {element.name!r} of {element.count} rows ends at byte "
                f"{offset + size}, the file has {len(data)}"
            )
        rows[element.name] = np.frombuffer(data, element.dtype, element.count, offset) if size else _no_rows(element)
        offset += size
    return rows


def _text_rows(data: bytes, header: PlyHeader, source: str) -> dict[str, NDArray[np.void]]:
    """Parse one row per line, values separated by blanks. Raises :class:`SceneError`."""
    lines = io.TextIOWrapper(io.BytesIO(memoryview(data)[header.body :]), encoding="latin-1")
    rows: dict[str, NDArray[np.void]] = {}
    for element in header.elements:
        if 2 * element.count * len(element.properties) > len(data) - header.body + 1:  # at least two bytes a value
            raise SceneError(f"{source}: is cut short: element {element.name!r} claims {element.count} rows")
        rows[element.name] = np.zeros(element.count, element.dtype)
        if not element.count or not element.properties:
            continue
        table = _table(islice(lines, element.count), element, source)
        for column, (name, _) in enumerate(element.properties):
            rows[element.name][name] = table[:, column]
    return rows


def _table(lines: Iterable[str], element: PlyElement, source: str) -> NDArray[np.float64]:
    """The table [rows, properties] in an element's ``lines``."""
    try:
        with warnings.catch_warnings(action="ignore"):  # about empty input, which the shape check reports
            table: NDArray[np.float64] = np.loadtxt(lines, np.float64, comments=None, ndmin=2)
    except ValueError as error:
        raise SceneError(f"{source}: element {element.name!r} does not consist of rows of numbers ({error})") from error
    if table.shape != (element.count, len(element.properties)):
        wanted = f"{element.count} rows of {len(element.properties)} numbers"
        raise SceneError(
            f"{source}: element {element.name!r} has {table.shape[0]} rows of {table.shape[1]}, not {wanted}"
        )
    return table


def _no_rows(element: PlyElement) -> NDArray[np.void]:
    return np.zeros(0, element.dtype)


def columns(rows: NDArray[np.void], names: list[str]) -> NDArray[np.float32]:
    """The named properties as columns, [N, len(names)] float32."""
    out = np.empty((len(rows), len(names)), np.float32)
    for column, name in enumerate(names):
        out[:, column] = rows[name]
    return out


def check_properties(element: PlyElement, names: list[str], source: str) -> None:
    """Raise :class:`SceneError` if ``element`` lacks one of ``names``, naming the first."""
    known: set[Any] = {name for name, _ in element.properties}
    for name in names:
        if name not in known:
            raise SceneError(f"{source}: element {element.name!r} has no property {name!r}; this PLY holds no splats")


def header_bytes(lines: list[str]) -> bytes:
    """A little-endian PLY header with the given element and property ``lines``."""
    return "\n".join(["ply", "format binary_little_endian 1.0", *lines, "end_header", ""]).encode("ascii")
