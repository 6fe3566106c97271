"""Writing bundles: all or nothing, and the same bytes for the same input.

A local bundle is written into a hidden sibling folder and renamed at the end. On other stores files are written in
place and the manifest, without which nothing is a bundle, comes last.
"""

from __future__ import annotations

import glob
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import Any

from cags_common.bundle.index import (
    SOURCE_MAGIC,
    TILES_MAGIC,
    FrameEntry,
    TileEntry,
    encode_source_index,
    encode_tile_index,
)
from cags_common.bundle.manifest import FileEntry, GofFiles, Manifest
from cags_common.bundle.quality import QUALITY_NAME, LodQuality
from cags_common.bundle.reader import CODEBOOKS_NAME, MANIFEST_NAME
from cags_common.bundle.store import filesystem, local_path, remove_tree
from cags_common.coding.packing import crc32, encode_ids
from cags_common.errors import BundleError
from cags_common.geometry import Vec3
from cags_common.splats import Ids
from cags_common.tiles.kinds import TileKind


@dataclass(frozen=True, eq=False)
class TilePayloads:
    """One encoded tile: what its entry says, and one payload a LoD."""

    splats: int
    first_id: int | None
    bounds: tuple[Vec3, Vec3]
    payloads: tuple[bytes, ...]
    kind: TileKind = TileKind.LOOKS
    looks: tuple[int, int] | None = None
    """Media frame and tile that a tile of motion moves."""
    span: int = 0


class BundleWriter:
    """Writes one bundle; use as a context manager and :meth:`commit` last. Without it nothing is left behind."""

    def __init__(self, url: str) -> None:
        self._url = str(url)
        self._target = local_path(self._url)
        self._gofs: list[GofFiles] = []
        self._open: GofWriter | None = None
        self._committed = False
        if self._target is not None:
            self._check_target(self._target)
            self._scratch = self._target.parent / f".{self._target.name}.partial-{os.getpid()}"
            remove_tree(self._scratch)
            _remove_abandoned(self._target)
            place = str(self._scratch)
        else:
            place = self._url
        self._fs, self._path = filesystem(place)
        self._prepare()

    def __enter__(self) -> BundleWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._open is not None:
            self._open.abort()
        if not self._committed:
            self._discard()

    def open_gof(self, first_frame: int, lods: int) -> GofWriter:
        """Begin the next group of frames; close it before the next is opened."""
        self._open = GofWriter(self, len(self._gofs), first_frame, lods)
        return self._open

    def codebooks(self, data: bytes) -> None:
        """Write the serialised codebooks."""
        with self.open_file(CODEBOOKS_NAME) as file:
            file.write(data)

    def quality(self, quality: LodQuality) -> None:
        """Write what was measured of the LoDs."""
        with self.open_file(QUALITY_NAME) as file:
            file.write(quality.to_json())

    def commit(self, manifest: Manifest) -> Manifest:
        """Write the manifest with the groups' files filled in, and put the bundle in its place."""
        complete = replace(manifest, gofs=tuple(self._gofs))
        with self.open_file(MANIFEST_NAME) as file:
            file.write(complete.to_json())
        if self._target is not None:
            self._swap_in(self._target)
        self._committed = True
        return complete

    def open_file(self, name: str) -> Any:
        """A binary file of the bundle, for writing. Raises :class:`BundleError`."""
        try:
            return self._fs.open(f"{self._path}/{name}", "wb")
        except OSError as error:
            raise BundleError(f"{self._url}: {name} cannot be written ({error.strerror or error})") from error

    def add_gof(self, files: GofFiles) -> None:
        """Record a closed group."""
        self._open = None
        self._gofs.append(files)

    def _check_target(self, target: Path) -> None:
        if target.is_file() or (target.is_dir() and any(target.iterdir()) and not (target / MANIFEST_NAME).is_file()):
            raise BundleError(f"{self._url}: exists and is not a bundle; give another name, nothing was overwritten")

    def _prepare(self) -> None:
        try:
            self._fs.makedirs(f"{self._path}/source", exist_ok=True)
            if self._target is None and self._fs.exists(f"{self._path}/{MANIFEST_NAME}"):
                self._fs.rm_file(f"{self._path}/{MANIFEST_NAME}")
        except OSError as error:
            raise BundleError(f"{self._url}: cannot be written ({error.strerror or error})") from error

    def _swap_in(self, target: Path) -> None:
        old = target.parent / f".{target.name}.replaced-{os.getpid()}"
        remove_tree(old)
        try:
            if target.exists():
                target.rename(old)
            self._scratch.rename(target)
        except OSError as error:
            if old.exists() and not target.exists():
                old.rename(target)
            raise BundleError(f"{self._url}: cannot be put in place ({error.strerror})") from error
        remove_tree(old)

    def _discard(self) -> None:
        if self._target is not None:
            remove_tree(self._scratch)
        elif self._fs.exists(self._path):
            self._fs.rm(self._path, recursive=True)


def _remove_abandoned(target: Path) -> None:
    """Delete what killed processes of this machine left of the same bundle."""
    for scratch in target.parent.glob(f".{glob.escape(target.name)}.partial-*"):
        pid = scratch.name.rpartition("-")[2]
        if not pid.isdecimal():
            continue
        try:
            os.kill(int(pid), 0)
        except ProcessLookupError:
            remove_tree(scratch)
        except (PermissionError, OverflowError):
            continue  # somebody else's process, or no process id


class GofWriter:
    """Appends the frames of one group, then its indices."""

    def __init__(self, bundle: BundleWriter, gof: int, first_frame: int, lods: int) -> None:
        self._bundle, self._gof, self._first, self._lods = bundle, gof, first_frame, lods
        self._names = f"gof_{gof:04d}.bin", f"source/gof_{gof:04d}.bin"
        self._files = [bundle.open_file(name) for name in self._names]
        self._files[0].write(TILES_MAGIC)
        self._files[1].write(SOURCE_MAGIC)
        self._entries: list[FrameEntry] = []
        self._sources: list[tuple[int, int]] = []
        self._offset = len(TILES_MAGIC)

    def frame(self, tiles: Sequence[TilePayloads], removed: Ids, source: bytes) -> FrameEntry:
        """Append the next frame: its tiles, the ids it removes, and its encoded source frame."""
        removed_bytes = encode_ids(removed)
        entry = FrameEntry(
            frame=self._first + len(self._entries),
            keyframe=not self._entries,
            gof=self._gof,
            tiles=tuple(_entry(index, tile) for index, tile in enumerate(tiles)),
            removed_count=len(removed),
            removed_bytes=len(removed_bytes),
            removed_crc=crc32(removed_bytes),
            offset=self._offset,
        )
        self._files[0].write(removed_bytes)
        for tile in tiles:
            for payload in tile.payloads:
                self._files[0].write(payload)
        self._files[1].write(source)
        self._sources.append((len(source), crc32(source)))
        self._entries.append(entry)
        self._offset += entry.size_bytes
        return entry

    def close(self) -> None:
        """Write the indices and record the group in the bundle."""
        tiles = self._finish(0, self._offset, encode_tile_index(self._entries, self._lods))
        source_end = len(SOURCE_MAGIC) + sum(size for size, _ in self._sources)
        self._bundle.add_gof(GofFiles(tiles, self._finish(1, source_end, encode_source_index(self._sources))))

    def abort(self) -> None:
        """Close the files without an index."""
        for file in self._files:
            file.close()

    def _finish(self, which: int, offset: int, index: bytes) -> FileEntry:
        self._files[which].write(index)
        self._files[which].close()
        return FileEntry(self._names[which], offset, crc32(index), offset + len(index))


def _entry(index: int, tile: TilePayloads) -> TileEntry:
    sizes = tuple(len(payload) for payload in tile.payloads)
    crcs = tuple(map(crc32, tile.payloads))
    return TileEntry(index, tile.splats, tile.first_id, tile.bounds, sizes, crcs, tile.kind, tile.looks, tile.span)
