"""Detects the format of a file from its name and first bytes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from cags_common.errors import SceneError
from cags_common.files import write_whole
from cags_common.geometry import Vec3
from cags_common.splats import Splats
from cags_encoder.formats.compressed_ply import compressed_ply_bytes, is_compressed_ply, parse_compressed_ply
from cags_encoder.formats.files import read_file
from cags_encoder.formats.ply import parse_ply, ply_bytes
from cags_encoder.formats.ply_container import parse_header
from cags_encoder.formats.repair import Check
from cags_encoder.formats.sog import parse_sog, parse_sog_bytes
from cags_encoder.formats.sog_files import SogFiles
from cags_encoder.formats.sog_writer import sog_bytes
from cags_encoder.formats.splat import parse_splat, splat_bytes
from cags_encoder.formats.spz import parse_spz, spz_bytes

Y_DOWN: Vec3 = (0.0, -1.0, 0.0)
"""Up direction of captures: COLMAP's camera frame has y pointing down, and 3DGS training keeps it."""

Y_UP: Vec3 = (0.0, 1.0, 0.0)


class Parser(Protocol):
    """Parses the bytes of a file."""

    def __call__(self, data: bytes, source: str, check: Check = Splats.checked) -> Splats:
        """The splats in ``data``; ``source`` names the file in errors. Raises :class:`SceneError`."""
        ...


@dataclass(frozen=True, slots=True)
class Format:
    """One file format."""

    name: str
    suffix: str  # lower case, including the dot
    parse: Parser
    write: Callable[[Splats], bytes]
    up: Vec3  # usual up direction; files do not record it


FORMATS: dict[str, Format] = {
    entry.name: entry
    for entry in (
        Format("ply", ".ply", parse_ply, ply_bytes, Y_DOWN),
        Format("compressed-ply", ".compressed.ply", parse_compressed_ply, compressed_ply_bytes, Y_DOWN),
        Format("splat", ".splat", parse_splat, splat_bytes, Y_DOWN),
        Format("spz", ".spz", parse_spz, spz_bytes, Y_UP),
        Format("sog", ".sog", parse_sog_bytes, sog_bytes, Y_DOWN),
    )
}
SUFFIXES = tuple(sorted({f".{entry.suffix.rpartition('.')[2]}" for entry in FORMATS.values()}))
"""Last suffixes of single-file formats."""

META = "meta.json"
"""A folder that contains this file is an unbundled SOG data set."""


def detect_format(path: Path, data: bytes) -> Format:
    """The format of a file by its name and, for ``.ply``, its content. Raises :class:`SceneError`."""
    if path.suffix.lower() == ".ply":
        return FORMATS["compressed-ply" if is_compressed_ply(parse_header(data, str(path))) else "ply"]
    return format_of_name(path)


def read_splats(path: Path, check: Check = Splats.checked) -> tuple[Splats, Format]:
    """Read one file, or a folder with an unbundled SOG; ``check`` decides what happens to splats that cannot be drawn.

    Raises :class:`SceneError`.
    """
    if path.name == META:
        path = path.parent
    if path.is_dir():
        return parse_sog(SogFiles.from_folder(path), check), FORMATS["sog"]
    if path.suffix.lower() not in SUFFIXES and path.is_file():
        raise SceneError(
            f"{path}: suffix {path.suffix!r} is unknown; known: {', '.join(SUFFIXES)}, a folder with {META}"
        )
    data = read_file(path)
    entry = detect_format(path, data)
    return entry.parse(data, str(path), check), entry


def write_splats(path: Path, splats: Splats) -> Format:
    """Write ``splats`` in the format given by the suffix of ``path``, atomically.

    Raises :class:`SceneError` for unknown suffixes and :class:`OutputError` if the file cannot be written.
    """
    entry = format_of_name(path)
    write_whole(path, entry.write(splats))
    return entry


def format_of_name(path: Path) -> Format:
    """The format given by a file's name. Raises :class:`SceneError` for unknown suffixes."""
    name = path.name.lower()
    matching = [entry for entry in FORMATS.values() if name.endswith(entry.suffix)]
    if not matching:
        raise _unknown_suffix(path)
    return max(matching, key=lambda entry: len(entry.suffix))


def _unknown_suffix(path: Path) -> SceneError:
    return SceneError(f"{path}: suffix {path.suffix!r} is unknown; known: {', '.join(SUFFIXES)}, a folder with {META}")
