"""Updates: attributes that changed, of splats that are there; whatever is not in an update stays as it was.

LoD 0 is a header, the ids of all splats of which something changed, a bit a splat and attribute that says what, and the
base codes of what changed. Each further LoD holds the codes of one layer of one attribute, for the splats whose
attribute changed. Positions and rotations are motion's (:mod:`cags_common.motion`). Layout: ``docs/bundle.md``.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from copy import copy

import numpy as np
from numpy.typing import NDArray

from cags_common.coding.packing import (
    U32,
    PackedCodes,
    decode_ids,
    encode_ids,
    pack_bits,
    packed_bytes,
    squeeze,
    unsqueeze,
)
from cags_common.errors import DecodeError
from cags_common.geometry import F32
from cags_common.splats import SH_REST_OF_DEGREE, Ids
from cags_common.tiles.attributes import SH_REST_ATTRIBUTES, alpha_logits
from cags_common.tiles.kinds import TileKind
from cags_common.tiles.lod import LodLayer
from cags_common.tiles.payloads import MAX_TILE_SPLATS, decode_layer, encode_layer
from cags_common.tiles.svq import CodebookSet

UPDATE_VERSION = 3
"""First byte of an update's LoD 0, as :data:`~cags_common.tiles.payloads.BASE_VERSION` is of a tile of looks."""

_HEAD = struct.Struct("<BBxxIII")  # version, attributes, splats, bytes of the id list and of the masks

Masks = Mapping[str, NDArray[np.bool_]]


def encode_update(
    ids: Ids, changed: Masks, codes: Mapping[str, U32], books: CodebookSet, order: Sequence[LodLayer]
) -> tuple[bytes, ...]:
    """A payload for each LoD: of splats ``ids`` [n] ascending, attribute by attribute which ``changed`` [n] and the
    ``codes`` [n] of full length, of which those that changed are taken.
    """
    masks = squeeze(b"".join(np.packbits(changed[book.attribute], bitorder="little").tobytes() for book in books))
    id_bytes = encode_ids(ids)
    chosen = {name: codes[name][mask] for name, mask in changed.items()}
    base = b"".join(pack_bits(book.layer(chosen[book.attribute], 0), book.layer_bits[0]) for book in books)
    head = _HEAD.pack(UPDATE_VERSION, len(books), len(ids), len(id_bytes), len(masks))
    out = [head + id_bytes + masks + squeeze(base)]
    for item in order:
        book = books[item.attribute]
        layer = book.layer(chosen[item.attribute], item.layer)
        out.append(encode_layer(layer, book.layer_bits[item.layer]) if len(layer) else b"")
    return tuple(out)


class UpdateState:
    """An update as far as it has come; layers may come in any order. Not thread-safe."""

    kind = TileKind.UPDATE

    def __init__(self, payload: bytes | memoryview, books: CodebookSet, order: Sequence[LodLayer]) -> None:
        """Decode LoD 0. Raises :class:`DecodeError`."""
        self._books, self._order = books, tuple(order)
        self.ids, self.changed, codes = _opened(payload, books)
        self._codes = codes
        self._depth = dict.fromkeys(books.attributes, 1)
        self._waiting: dict[tuple[str, int], PackedCodes] = {}

    def __len__(self) -> int:
        return len(self.ids)

    @property
    def lod(self) -> int:
        """Highest LoD up to which everything has come; what nothing changed of has nothing to come."""
        for level, item in enumerate(self._order):
            if len(self._codes[item.attribute]) and self._depth[item.attribute] <= item.layer:
                return level
        return len(self._order)

    def add_layer(self, lod: int, payload: bytes | memoryview) -> bool:
        """Take LoD ``lod`` >= 1; whether :meth:`values` changed. Raises :class:`DecodeError`."""
        if not 1 <= lod <= len(self._order):
            raise DecodeError(f"update: LoD {lod} is outside 1 to {len(self._order)}")
        item = self._order[lod - 1]
        count = len(self._codes[item.attribute])
        if not count or item.layer < self._depth[item.attribute]:
            return False
        bits = self._books[item.attribute].layer_bits[item.layer]
        self._waiting[item.attribute, item.layer] = decode_layer(payload, count, bits)
        return self._absorb(item.attribute)

    def fork(self) -> UpdateState:
        """Another state of what has come; what is added to one of the two does not change the other."""
        other = copy(self)
        other._codes, other._depth, other._waiting = dict(self._codes), dict(self._depth), dict(self._waiting)
        return other

    def reduced(self, lods: int) -> UpdateState:
        """Another state, of LoDs 0 .. ``lods`` - 1 alone, all of which have come."""
        other = self.fork()
        other._waiting.clear()
        for name, held in self._depth.items():
            wanted = 1 + max((item.layer for item in self._order[: lods - 1] if item.attribute == name), default=0)
            depth = other._depth[name] = min(wanted, held)
            other._codes[name] = self._codes[name] >> np.uint32(sum(self._books[name].layer_bits[depth:held]))
        return other

    def _absorb(self, name: str) -> bool:
        before = self._depth[name]
        while (part := self._waiting.pop((name, self._depth[name]), None)) is not None:
            codes = self._codes[name]
            self._codes[name] = (codes << np.uint32(part.bits)) | part.unpack(len(codes))
            self._depth[name] += 1
        return self._depth[name] > before

    def values(self) -> dict[str, tuple[NDArray[np.intp], F32]]:
        """Column of :class:`Splats` -> (ids [m], values [m, ...]) at the depths there are."""
        out: dict[str, tuple[NDArray[np.intp], F32]] = {}
        for book in self._books:
            name = book.attribute
            if name in _PLAIN and len(self._codes[name]):
                ids = self.ids[self.changed[name]].astype(np.intp)
                values = book.lookup(self._codes[name], self._depth[name])
                if name == "alpha":
                    values = alpha_logits(values)
                column = _PLAIN[name]
                out[column] = ids, np.ascontiguousarray(values[:, 0] if column == "logit_opacities" else values)
        bands = [name for name in SH_REST_ATTRIBUTES if name in self._books.attributes]
        if bands and len(self._codes[bands[0]]):
            parts = [self._books[name].lookup(self._codes[name], self._depth[name]) for name in bands]
            rest = np.concatenate(parts, axis=1).reshape(len(parts[0]), SH_REST_OF_DEGREE[len(bands)], 3)
            out["sh_rest"] = self.ids[self.changed[bands[0]]].astype(np.intp), np.ascontiguousarray(rest)
        return out


_PLAIN = {"scale": "log_scales", "opacity": "logit_opacities", "alpha": "logit_opacities", "sh0": "sh0"}

UPDATE_COLUMNS = ("log_scales", "logit_opacities", "sh0", "sh_rest")
"""Columns of splats that updates may change."""


def update_ids(payload: bytes | memoryview) -> Ids:
    """Only the ids [n] of an update's LoD 0. Raises :class:`DecodeError`."""
    return _read_ids(payload)[0]


def _read_ids(payload: bytes | memoryview) -> tuple[Ids, int, int, memoryview]:
    """Ids, attributes, bytes of the masks, and what follows the ids."""
    view = memoryview(payload)
    if len(view) < _HEAD.size:
        raise DecodeError(f"update: {len(view)} bytes are too few")
    version, attributes, splats, id_bytes, mask_bytes = _HEAD.unpack_from(view)
    if version != UPDATE_VERSION or splats > MAX_TILE_SPLATS or id_bytes + mask_bytes > len(view) - _HEAD.size:
        raise DecodeError(f"update: version {version}, {splats} splats, {id_bytes} bytes of ids; beyond bounds")
    ids = decode_ids(view[_HEAD.size : _HEAD.size + id_bytes], what="update's ids")
    if len(ids) != splats:
        raise DecodeError(f"update: has {len(ids)} ids for {splats} splats")
    return ids, attributes, mask_bytes, view[_HEAD.size + id_bytes :]


def update_parts(payload: bytes | memoryview) -> dict[str, int]:
    """Bytes of an update's LoD 0 by what they tell. Raises :class:`DecodeError`."""
    _, _, masks, rest = _read_ids(payload)
    told = {"heads": _HEAD.size, "ids": len(payload) - _HEAD.size - len(rest), "masks": masks}
    return told | {"base codes": len(rest) - masks}


def _opened(
    payload: bytes | memoryview, books: CodebookSet
) -> tuple[Ids, dict[str, NDArray[np.bool_]], dict[str, U32]]:
    ids, attributes, mask_bytes, rest = _read_ids(payload)
    if attributes != len(books):
        raise DecodeError(f"update: has {attributes} attributes, the codebooks {len(books)}")
    row = (len(ids) + 7) // 8
    bits = np.frombuffer(unsqueeze(rest[:mask_bytes], row * len(books), "update: masks"), np.uint8)
    masks = np.unpackbits(bits.reshape(len(books), row), axis=1, count=len(ids), bitorder="little").astype(bool)
    changed = dict(zip(books.attributes, masks, strict=True))
    bands = [changed[name] for name in SH_REST_ATTRIBUTES if name in changed]
    if any(not np.array_equal(band, bands[0]) for band in bands):
        raise DecodeError("update: bands of harmonics change for different splats")
    sizes = {b.attribute: packed_bytes(int(changed[b.attribute].sum()), b.layer_bits[0]) for b in books}
    packed, at, codes = unsqueeze(rest[mask_bytes:], sum(sizes.values()), "update: base codes"), 0, {}
    for book in books:
        end = at + sizes[book.attribute]
        part = PackedCodes(packed[at:end], book.layer_bits[0])
        codes[book.attribute] = part.unpack(int(changed[book.attribute].sum()))
        at = end
    return ids, changed, codes
