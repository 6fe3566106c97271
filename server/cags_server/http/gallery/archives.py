"""Archives of frames that strangers send: limits first, and names that lead nowhere."""

from __future__ import annotations

import zipfile
from pathlib import Path

from cags_common.errors import CagsError

FRAMES = (".ply", ".spz", ".splat", ".sog")
MAX_ENTRIES = 10_000
CHUNK_BYTES = 1 << 20


class ArchiveError(CagsError):
    """Why an archive is not unpacked."""


def unpacked(archive: Path, folder: Path, most_bytes: int) -> Path:
    """The frames of a ZIP archive in a new ``folder``; one frame alone is a file, whose path it is.

    Frames are numbered in the order of their names; folders inside the archive, and other files, are left out. Raises
    :class:`ArchiveError` for what is no archive, has no frames, or is larger than ``most_bytes`` in all.
    """
    try:
        with zipfile.ZipFile(archive) as held:
            entries = _frames(held, most_bytes)
            folder.mkdir()
            suffix, left = Path(entries[0].filename).suffix.lower(), most_bytes
            for number, entry in enumerate(entries):
                left -= _copied(held, entry, folder / f"{number:05d}{suffix}", left)
    except (zipfile.BadZipFile, OSError, NotImplementedError, RuntimeError, EOFError, ValueError) as error:
        raise ArchiveError(f"{archive.name}: cannot be unpacked ({error})") from error
    found = sorted(folder.iterdir())
    return found[0] if len(found) == 1 else folder


def frame_names(archive: Path, most_bytes: int) -> list[str]:
    """What the archive calls the frames that :func:`unpacked` numbers, in their order, without folders."""
    with zipfile.ZipFile(archive) as held:
        return [Path(entry.filename).name for entry in _frames(held, most_bytes)]


def _frames(held: zipfile.ZipFile, most_bytes: int) -> list[zipfile.ZipInfo]:
    entries = held.infolist()
    if len(entries) > MAX_ENTRIES:
        raise ArchiveError(f"the archive holds {len(entries)} files; at most {MAX_ENTRIES} are taken")
    names = {entry.filename: entry for entry in entries if entry.filename.lower().endswith(FRAMES)}
    frames = [names[name] for name in sorted(names, key=_natural) if not Path(name).name.startswith(".")]
    if not frames:
        raise ArchiveError(f"the archive holds no frames; known are {', '.join(FRAMES)}")
    kinds = sorted({Path(entry.filename).suffix.lower() for entry in frames})
    if len(kinds) > 1:
        raise ArchiveError(f"the archive mixes {kinds[0]} and {kinds[1]}; send one sequence of one format")
    size = sum(entry.file_size for entry in frames)
    if size > most_bytes:
        raise ArchiveError(f"the archive unpacks to {size} bytes; at most {most_bytes} are taken")
    return frames


def _copied(held: zipfile.ZipFile, entry: zipfile.ZipInfo, target: Path, most_bytes: int) -> int:
    """Unpack one file; its bytes. What the archive says of its size is not believed."""
    got = 0
    with held.open(entry) as data, target.open("wb") as out:
        while part := data.read(CHUNK_BYTES):
            got += len(part)
            if got > most_bytes:
                raise ArchiveError(f"the archive unpacks to more than the {most_bytes} bytes that are left")
            out.write(part)
    return got


def _natural(name: str) -> tuple[tuple[int, str], ...]:
    """Sort key by which 2 comes before 10."""
    parts, digits = [], ""
    for c in f"{name}\0":
        if c.isascii() and c.isdigit():
            digits += c
            continue
        if digits:
            parts.append((int(digits[-18:]), ""))
            digits = ""
        parts.append((-1, c))
    return tuple(parts)
