"""Writing bundles: all or nothing, and the same bytes for the same input.

Where the files go, and what may be replaced there, says :mod:`cags_common.bundle.places`. The manifest, without which
nothing is a bundle, comes last.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from types import TracebackType

from cags_common.bundle.index import (
    SOURCE_MAGIC,
    TILES_MAGIC,
    FrameEntry,
    SourceEntry,
    TileEntry,
    encode_source_index,
    encode_tile_index,
)
from cags_common.bundle.manifest import MAX_MANIFEST_BYTES, FileEntry, GofFiles, Manifest
from cags_common.bundle.places import OutputFile, place_of
from cags_common.bundle.quality import QUALITY_NAME, LodQuality
from cags_common.bundle.reader import CODEBOOKS_NAME, MANIFEST_NAME, MAX_WEIGHTS_BYTES, weights_name
from cags_common.bundle.source import head_bytes
from cags_common.bundle.store import UrlStore, filesystem, replace_files
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
    """Writes one bundle; use as a context manager and :meth:`commit` last. Without it nothing is left behind.

    An old bundle at ``url`` (a folder or an fsspec URL) is replaced: a local one at the end, elsewhere by the first
    file. Raises :class:`BundleError` if something else is there, and :class:`OutputError` if it cannot be written.
    """

    def __init__(self, url: str) -> None:
        self._place = place_of(str(url))
        self._gofs: list[GofFiles] = []
        self._committed = False

    def __enter__(self) -> BundleWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if not self._committed:
            self._place.discard()

    def open_gof(self, first_frame: int, lods: int) -> GofWriter:
        """Begin the next group of frames; close it before the next is opened."""
        return GofWriter(self, len(self._gofs), first_frame, lods)

    def codebooks(self, data: bytes) -> None:
        """Write the serialised codebooks."""
        with self.open_file(CODEBOOKS_NAME) as file:
            file.write(data)

    def quality(self, quality: LodQuality) -> None:
        """Write what was measured of the LoDs."""
        with self.open_file(QUALITY_NAME) as file:
            file.write(quality.to_json())

    def commit(self, manifest: Manifest) -> Manifest:
        """Write the manifest with the groups' files filled in, and put the bundle in its place.

        Raises :class:`BundleError` for a manifest that no reader would take, and leaves the bundle before in its place.
        """
        complete = replace(manifest, gofs=tuple(self._gofs))
        text = complete.to_json()
        Manifest.from_json(text)  # as readers will
        with self.open_file(MANIFEST_NAME) as file:
            file.write(text)
        self._place.finish()
        self._committed = True
        return complete

    def open_file(self, name: str) -> OutputFile:
        """A binary file of the bundle, for writing. Raises :class:`OutputError`, as do its methods."""
        return self._place.open(name)

    def add_gof(self, files: GofFiles) -> None:
        """Record a closed group."""
        self._gofs.append(files)


class GofWriter:
    """Appends the frames of one group, then its indices."""

    def __init__(self, bundle: BundleWriter, gof: int, first_frame: int, lods: int) -> None:
        self._bundle, self._gof, self._first, self._lods = bundle, gof, first_frame, lods
        self._names = f"gof_{gof:04d}.bin", f"source/gof_{gof:04d}.bin"
        self._files = [bundle.open_file(name) for name in self._names]
        self._files[0].write(TILES_MAGIC)
        self._files[1].write(SOURCE_MAGIC)
        self._entries: list[FrameEntry] = []
        self._sources: list[SourceEntry] = []
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
        head = memoryview(source)[: head_bytes(source)]
        self._sources.append(SourceEntry(len(source), len(head), crc32(head)))
        self._entries.append(entry)
        self._offset += entry.size_bytes
        return entry

    def close(self) -> None:
        """Write the indices and record the group in the bundle."""
        tiles = self._finish(0, self._offset, encode_tile_index(self._entries, self._lods))
        source_end = len(SOURCE_MAGIC) + sum(entry.size_bytes for entry in self._sources)
        self._bundle.add_gof(GofFiles(tiles, self._finish(1, source_end, encode_source_index(self._sources))))

    def _finish(self, which: int, offset: int, index: bytes) -> FileEntry:
        self._files[which].write(index)
        self._files[which].close()
        return FileEntry(self._names[which], offset, crc32(index), offset + len(index))


def _entry(index: int, tile: TilePayloads) -> TileEntry:
    sizes = tuple(len(payload) for payload in tile.payloads)
    crcs = tuple(map(crc32, tile.payloads))
    return TileEntry(index, tile.splats, tile.first_id, tile.bounds, sizes, crcs, tile.kind, tile.looks, tile.span)


def store_weights(url: str, data: bytes) -> None:
    """Put ``data``, weights of a restorer, into the bundle at ``url``, for servers to offer.

    The manifest is replaced last, by renaming: readers find the old weights or the new ones, never half of them. Raises
    :class:`BundleError`.
    """
    if len(data) > MAX_WEIGHTS_BYTES:
        raise BundleError(f"{url}: {len(data)} bytes of weights are more than the allowed {MAX_WEIGHTS_BYTES}")
    manifest = Manifest.from_json(UrlStore(url).read_all(MANIFEST_NAME, MAX_MANIFEST_BYTES))
    old, new = manifest.weights_crc, crc32(data)
    replace_files(url, {weights_name(new): data, MANIFEST_NAME: replace(manifest, weights_crc=new).to_json()})
    if old is not None and old != new:
        files, path = filesystem(url)
        try:
            files.rm_file(f"{path}/{weights_name(old)}")
        except OSError as error:
            raise BundleError(f"{url}: old weights stay there ({error.strerror or error})") from error
