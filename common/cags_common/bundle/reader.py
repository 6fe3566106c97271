"""Reading bundles by ranges."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import TracebackType

from cags_common.bundle.codecs import AnyTile, MotionTile, SvqTileCodec, anchors_of, tile_codec
from cags_common.bundle.index import FrameEntry, SourceEntry, TileEntry, decode_source_index, decode_tile_index
from cags_common.bundle.manifest import MAX_MANIFEST_BYTES, FileEntry, Manifest
from cags_common.bundle.quality import MAX_QUALITY_BYTES, QUALITY_NAME, LodQuality
from cags_common.bundle.source import SourceDelta, SourceFrame, SourceState, decode_source
from cags_common.bundle.store import ByteStore, UrlStore
from cags_common.coding.packing import check_crc, crc32, decode_ids
from cags_common.errors import BundleError, DecodeError
from cags_common.motion.neighbours import Anchors
from cags_common.runtime.recent import Recent
from cags_common.splats import Ids
from cags_common.tiles.svq import MAX_CODEBOOK_BYTES
from cags_common.tiles.updates import UpdateState

MANIFEST_NAME = "manifest.json"
THUMBNAIL_NAME = "thumbnail.jpg"
MAX_THUMBNAIL_BYTES = 1 << 18
CODEBOOKS_NAME = "codebooks.bin"
MAX_WEIGHTS_BYTES = 4 << 20

MOST_IDS_A_SPLAT, SPARE_IDS = 8, 65_536
"""Ids of a group are mostly dense: its capacity is at most so many times the splats that its tiles carry, and some."""


def weights_name(crc: int) -> str:
    """The file of a restorer's weights, by their CRC-32: new ones lie beside the old until the manifest names them."""
    return f"weights-{crc:08x}.npz"


@contextmanager
def naming(url: str) -> Iterator[None]:
    """Errors of what the bundle at ``url`` contains name it first, and say to encode the scene again.

    Errors that name it already, such as those of its store, stay as they are.
    """
    try:
        yield
    except (BundleError, DecodeError) as error:
        text = str(error)
        if text.startswith((f"{url}:", f"{url}/")):
            raise
        way_out = "" if text.endswith("encode again") else "; encode the scene again"
        raise type(error)(f"{url}: {text}{way_out}") from error


ANCHORS_BYTES = 16 << 20
"""Bound on the anchors in memory, which chunks of motion are decoded by."""

CACHED_BYTES, CACHED_FRAMES = 64 << 20, 16
"""Bound on the payloads in memory, and so many frames' in any case: one read fetches a frame, the streamer then picks
layers from it."""


def refuse_published(url: str, manifest: bytes) -> None:
    """Raise :class:`BundleError` if ``manifest``, a valid one, is that of a published folder at ``url``."""
    if "published" in json.loads(manifest):
        raise BundleError(
            f"{url}: is a folder made by cags-encode --publish, for web hosts; name the bundle that it was made of"
        )


class BundleReader:
    """An open bundle. Safe to use from several threads."""

    def __init__(self, store: ByteStore, manifest: Manifest, codebooks: bytes) -> None:
        self.manifest = manifest
        self.codec = tile_codec(manifest, codebooks)
        self._store, self._codebooks = store, codebooks
        self._lock, self._replaying = threading.Lock(), threading.Lock()
        self._index: dict[int, tuple[FrameEntry, ...]] = {}
        self._source_index: dict[int, tuple[SourceEntry, ...]] = {}
        self._frames = Recent[int, bytes](CACHED_BYTES, least=CACHED_FRAMES)
        self._anchors = Recent[tuple[int, int], Anchors](ANCHORS_BYTES)
        self._replay: tuple[int, SourceState] | None = None

    @classmethod
    def open(cls, url: str) -> BundleReader:
        """Open the bundle at ``url`` (folder or fsspec URL).

        Raises :class:`BundleError` or :class:`DecodeError`, which name the bundle and say what to do.
        """
        with naming(str(url)):
            store = UrlStore(str(url))
            data = store.read_all(MANIFEST_NAME, MAX_MANIFEST_BYTES)
            manifest = Manifest.from_json(data)
            refuse_published(str(url), data)
            if not manifest.gofs:
                raise BundleError(f"{url}: its manifest is the public part only and says nothing of files")
            codebooks = store.read_all(CODEBOOKS_NAME, MAX_CODEBOOK_BYTES)
            return cls(store, manifest, codebooks)

    def __enter__(self) -> BundleReader:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Drop what is cached; the reader may still be used afterwards."""
        with self._lock:
            self._frames.clear()
            self._anchors.clear()
        with self._replaying:
            self._replay = None

    def codebooks(self) -> bytes:
        """Serialised codebooks, for :func:`~cags_common.bundle.codecs.tile_codec`."""
        return self._codebooks

    def base_codebooks(self) -> bytes | None:
        """The part of the codebooks that tiles need at LoD 0, in the same form; None for codecs without such a part."""
        codec = self.codec
        return codec.base_codebooks() if isinstance(codec, SvqTileCodec) else None

    def quality(self) -> LodQuality | None:
        """What the encoder measured of the LoDs, None where it measured nothing. Raises :class:`BundleError`."""
        if not self._store.has(QUALITY_NAME):
            return None
        return LodQuality.from_json(self._store.read_all(QUALITY_NAME, MAX_QUALITY_BYTES))

    def thumbnail(self) -> bytes | None:
        """A small JPEG of the first view, None where the encoder made none. Raises :class:`BundleError`."""
        if not self._store.has(THUMBNAIL_NAME):
            return None
        return self._store.read_all(THUMBNAIL_NAME, MAX_THUMBNAIL_BYTES)

    def weights(self) -> bytes | None:
        """Weights of a restorer that were trained for this content, or None. Raises :class:`DecodeError`."""
        crc = self.manifest.weights_crc
        if crc is None:
            return None
        name = weights_name(crc)
        data = self._store.read_all(name, MAX_WEIGHTS_BYTES)
        check_crc(data, crc, name)
        return data

    def frame(self, frame: int) -> FrameEntry:
        """What ``frame`` holds. Raises :class:`BundleError` outside the bundle."""
        gof = self.manifest.gof_of(frame)
        return self._tile_index(gof)[frame - self.manifest.gof_starts[gof]]

    def at_hand(self, frame: int) -> bool:
        """Whether :meth:`frame`, :meth:`payload` and :meth:`removed_ids` of ``frame`` answer from memory."""
        with self._lock:
            return self.manifest.gof_of(frame) in self._index and frame in self._frames

    def payload(self, frame: int, tile: int, lod: int) -> bytes:
        """Payload of one LoD of one tile, its CRC-32 checked. Raises :class:`BundleError` or :class:`DecodeError`."""
        entry = self.frame(frame)
        item = self._tile(entry, tile)
        if not 0 <= lod < len(item.lod_bytes):
            raise BundleError(f"LoD {lod} is outside 0 to {len(item.lod_bytes) - 1}")
        at = entry.removed_bytes + sum(sum(t.lod_bytes) for t in entry.tiles[:tile]) + sum(item.lod_bytes[:lod])
        data = self._frame_bytes(entry)[at : at + item.lod_bytes[lod]]
        self._check(frame, data, item.crcs[lod], f"frame {frame}, tile {tile}, LoD {lod}")
        return data

    def open_tile(self, frame: int, tile: int, lod: int = 0) -> AnyTile:
        """A tile of any kind, at LoD 0; ``lod`` is another where every payload is a whole tile.

        Raises :class:`BundleError` or :class:`DecodeError`.
        """
        looks = self._tile(self.frame(frame), tile).looks
        anchors = None if looks is None else self.anchors(*looks)
        return self.codec.open_tile(self.payload(frame, tile, lod), anchors)

    def anchors(self, frame: int, tile: int) -> Anchors:
        """What motion of a tile of looks is told by. Raises :class:`BundleError` or :class:`DecodeError`."""
        key = frame, tile
        with self._lock:
            known = self._anchors.get(key)
        if known is None:
            state = self.codec.open_tile(self.payload(frame, tile, 0))
            known = None if isinstance(state, MotionTile | UpdateState) else anchors_of(state)
            if known is None:
                raise BundleError(f"frame {frame}, tile {tile}: no tile of looks that could move")
            with self._lock:
                self._anchors.put(key, known, known.nbytes)
        return known

    def tile_ids(self, frame: int, tile: int) -> Ids:
        """Ids [n] of a tile's splats, ascending, in the tile's order; of motion, those of the looks that it moves.

        Raises :class:`BundleError`.
        """
        looks = self._tile(self.frame(frame), tile).looks
        return self.within(self.codec.tile_ids(self.payload(*(looks or (frame, tile)), 0)), frame, f"tile {tile}")

    def removed_payload(self, frame: int) -> bytes:
        """The ids that ``frame`` removes, packed by :func:`~cags_common.coding.packing.encode_ids`."""
        entry = self.frame(frame)
        data = self._frame_bytes(entry)[: entry.removed_bytes]
        self._check(frame, data, entry.removed_crc, f"frame {frame}, removed ids")
        return data

    def removed_ids(self, frame: int) -> Ids:
        """The ids [n] that ``frame`` removes, ascending; none in key frames."""
        gof = self.manifest.gof_of(frame)
        return decode_ids(self.removed_payload(frame), what=f"frame {frame}", limit=self.manifest.capacity[gof])

    def source_delta(self, frame: int) -> SourceDelta:
        """What the unquantised ``frame`` changes against the one before (everything in the first of a group).

        Values are read when they are asked for, which raises :class:`BundleError` or :class:`DecodeError` where that
        fails.
        """
        gof = self.manifest.gof_of(frame)
        self._tile_index(gof)  # which checks the capacity
        row = frame - self.manifest.gof_starts[gof]
        entries, name, what = self._sources(gof), self.manifest.gofs[gof].source.name, f"source frame {frame}"
        start, entry = 8 + sum(entry.size_bytes for entry in entries[:row]), entries[row]
        head = self._store.read(name, start, start + entry.head_bytes)
        check_crc(head, entry.head_crc, what)
        delta = decode_source(head, what, lambda first, end: self._store.read(name, start + first, start + end))
        if delta.packed_bytes != entry.size_bytes:
            raise BundleError(f"{what}: takes {delta.packed_bytes} bytes where its index has {entry.size_bytes}")
        self.within(delta.ids, frame, "source")
        self.within(delta.removed, frame, "source, removed")
        self.within(delta.moved_ids, frame, "source, moved")
        return delta

    def source(self, frame: int) -> SourceFrame:
        """All unquantised splats alive in ``frame``. Cheapest in rising order: an earlier frame replays its group."""
        gof = self.manifest.gof_of(frame)
        first = self.manifest.gof_starts[gof]
        self._tile_index(gof)
        with self._replaying:  # seconds of reading and decoding: payloads need not wait for it
            if self._replay is None or not first <= self._replay[0] <= frame:
                state = SourceState(self.manifest.capacity[gof], self.manifest.sh_degree)
                state.apply(self.source_delta(first))
                self._replay = first, state
            at, state = self._replay
            for later in range(at + 1, frame + 1):
                state.apply(self.source_delta(later))
                self._replay = later, state
            return state.frame()

    def _tile_index(self, gof: int) -> tuple[FrameEntry, ...]:
        known = self._index.get(gof)
        if known is None:  # two threads may read it side by side: both read the same
            data = self._read_index(self.manifest.gofs[gof].tiles)
            frames = self.manifest.gof_frames(gof)
            known = decode_tile_index(data, gof=gof, frames=frames, lods=self.manifest.lods)
            self._check_capacity(gof, known)
            self._index[gof] = known
        return known

    def _check_capacity(self, gof: int, entries: tuple[FrameEntry, ...]) -> None:
        """Whoever draws a group takes memory for its capacity: it must not claim far more ids than tiles carry."""
        capacity, carried = self.manifest.capacity[gof], sum(t.splats for entry in entries for t in entry.tiles)
        if capacity > MOST_IDS_A_SPLAT * carried + SPARE_IDS:
            raise BundleError(
                f"manifest: capacity[{gof}] = {capacity} is far more than the {carried} splats that the group's tiles "
                "carry; encode the bundle again"
            )

    def _sources(self, gof: int) -> tuple[SourceEntry, ...]:
        known = self._source_index.get(gof)
        if known is None:
            data = self._read_index(self.manifest.gofs[gof].source)
            frames = len(self.manifest.gof_frames(gof))
            known = self._source_index[gof] = decode_source_index(data, gof=gof, frames=frames)
        return known

    def _read_index(self, file: FileEntry) -> bytes:
        data = self._store.read(file.name, file.index_offset, file.size_bytes)
        if crc32(data) != file.index_crc:
            raise BundleError(f"{file.name}: its index is damaged (CRC-32 differs); encode or copy the bundle again")
        return data

    def _frame_bytes(self, entry: FrameEntry) -> bytes:
        with self._lock:
            data = self._frames.get(entry.frame)
        if data is None:  # read without the lock: frames that are there already need not wait for a slow store
            name = self.manifest.gofs[entry.gof].tiles.name
            data = self._store.read(name, entry.offset, entry.offset + entry.size_bytes)
            with self._lock:
                self._frames.put(entry.frame, data, len(data))
        return data

    def _check(self, frame: int, data: bytes, crc: int, what: str) -> None:
        """Check a CRC-32; a frame that is damaged is read anew next time: its file may have been put back by then."""
        try:
            check_crc(data, crc, what)
        except DecodeError:
            with self._lock:
                self._frames.drop(frame)
            raise

    def within(self, ids: Ids, frame: int, what: str) -> Ids:
        """``ids``, which index arrays and kernels' memory. Raises :class:`BundleError` beyond the group's capacity."""
        capacity = self.manifest.capacity[self.manifest.gof_of(frame)]
        if len(ids) and not 0 <= int(ids.min()) <= int(ids.max()) < capacity:
            raise BundleError(
                f"frame {frame}, {what}: ids {int(ids.min())} to {int(ids.max())} do not lie within the group's "
                f"capacity of {capacity}; encode the bundle again"
            )
        return ids

    @staticmethod
    def _tile(entry: FrameEntry, tile: int) -> TileEntry:
        if not 0 <= tile < len(entry.tiles):
            raise BundleError(f"frame {entry.frame} has {len(entry.tiles)} tiles; there is no tile {tile}")
        return entry.tiles[tile]
