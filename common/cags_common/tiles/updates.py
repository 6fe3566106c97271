"""Updates: attributes that changed, of splats that are there; whatever is not in an update stays as it was.

LoD 0 is a header, the ids of all splats of which something changed, a bit a splat and attribute that says what, and the
base codes of what changed. For each change it is said in how many frames its value is reached (:mod:`.ramps`);
opacities change at once. Each further LoD holds the codes of one layer of one attribute, for the splats whose
attribute changed. Positions and rotations are motion's (:mod:`cags_common.motion`). Layout: ``docs/bundle.md``.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass

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
from cags_common.tiles.lod import POSITION, LodLayer
from cags_common.tiles.payloads import MAX_TILE_SPLATS, decode_layer, encode_layer
from cags_common.tiles.ramps import AT_ONCE, LONGEST_RAMP, U8
from cags_common.tiles.svq import CodebookSet

UPDATE_VERSION = 5
"""First byte of an update's LoD 0, as :data:`~cags_common.tiles.payloads.BASE_VERSION` is of a tile of looks."""

_HEAD = struct.Struct("<BBxxIIII")  # version, attributes, splats, bytes of the id list, of the masks and of the ramps

Masks = Mapping[str, NDArray[np.bool_]]

_PLAIN = {"scale": "log_scales", "opacity": "logit_opacities", "alpha": "logit_opacities", "sh0": "sh0"}

UPDATE_COLUMNS = ("log_scales", "logit_opacities", "sh0", "sh_rest")
"""Columns of splats that updates may change."""

RAMP_COLUMNS = ("log_scales", "sh0", "sh_rest")
"""Those that may reach their value in more than one frame."""

_RAMPED = {"scale": "log_scales", "sh0": "sh0", SH_REST_ATTRIBUTES[0]: "sh_rest"}
"""Attribute -> column of :data:`RAMP_COLUMNS`; bands of harmonics change together."""


@dataclass(frozen=True, eq=False)
class Change:
    """New values of one column of splats."""

    ids: NDArray[np.intp]  # [m]
    values: F32  # [m, ...]
    frames: U8  # [m] in how many frames each value is reached, 1 to LONGEST_RAMP

    def take(self, rows: NDArray[np.bool_]) -> Change:
        """The change of those that ``rows`` [m] selects."""
        at = np.flatnonzero(rows)
        return Change(self.ids.take(at), self.values.take(at, axis=0), self.frames.take(at))


def encode_update(  # noqa: PLR0917
    ids: Ids,
    changed: Masks,
    codes: Mapping[str, U32],
    books: CodebookSet,
    order: Sequence[LodLayer],
    frames: Mapping[str, U8] | None = None,
) -> tuple[bytes, ...]:
    """A payload for each LoD: of splats ``ids`` [n] ascending, attribute by attribute which ``changed`` [n] and the
    ``codes`` [n] of full length, of which those that changed are taken. ``frames``: column of :data:`RAMP_COLUMNS` ->
    in how many frames [n] values are reached; at once without it.
    """
    masks = squeeze(b"".join(np.packbits(changed[book.attribute], bitorder="little").tobytes() for book in books))
    id_bytes = encode_ids(ids)
    chosen = {name: codes[name][mask] for name, mask in changed.items()}
    base = b"".join(pack_bits(book.layer(chosen[book.attribute], 0), book.layer_bits[0]) for book in books)
    ramps = _encoded_ramps(changed, frames or {})
    head = _HEAD.pack(UPDATE_VERSION, len(books), len(ids), len(id_bytes), len(masks), len(ramps))
    out = [head + id_bytes + masks + ramps + squeeze(base)]
    for item in order:
        if item.attribute == POSITION:
            out.append(b"")
            continue
        book = books[item.attribute]
        layer = book.layer(chosen[item.attribute], item.layer)
        out.append(encode_layer(layer, book.layer_bits[item.layer]) if len(layer) else b"")
    return tuple(out)


def _encoded_ramps(changed: Masks, frames: Mapping[str, U8]) -> bytes:
    """A byte for each change of what may be in a ramp; nothing if there is none."""
    parts = [frames[_RAMPED[a]][mask] - 1 for a, mask in changed.items() if _RAMPED.get(a) in frames]
    joined = np.concatenate([np.zeros(0, np.uint8), *parts])
    return squeeze(joined.tobytes()) if joined.any() else b""


class UpdateState:
    """An update as far as it has come; layers may come in any order. Not thread-safe."""

    kind = TileKind.UPDATE

    def __init__(self, payload: bytes | memoryview, books: CodebookSet, order: Sequence[LodLayer]) -> None:
        """Decode LoD 0. Raises :class:`DecodeError`."""
        self._books, self._order = books, tuple(order)
        self.ids, self.changed, self._frames, codes = _opened(payload, books)
        self._codes = codes
        self._depth = dict.fromkeys(books.attributes, 1)
        self._waiting: dict[tuple[str, int], PackedCodes] = {}

    def __len__(self) -> int:
        return len(self.ids)

    @property
    def lod(self) -> int:
        """Highest LoD up to which everything has come; what nothing changed of has nothing to come."""
        for level, item in enumerate(self._order):
            if self._changes(item.attribute) and self._depth[item.attribute] <= item.layer:
                return level
        return len(self._order)

    def add_layer(self, lod: int, payload: bytes | memoryview) -> bool:
        """Take LoD ``lod`` >= 1; whether :meth:`values` changed. Raises :class:`DecodeError`."""
        if not 1 <= lod <= len(self._order):
            raise DecodeError(f"update: LoD {lod} is outside 1 to {len(self._order)}")
        item = self._order[lod - 1]
        count = self._changes(item.attribute)
        if not count or item.layer < self._depth[item.attribute]:
            return False
        bits = self._books[item.attribute].bits_of(item.layer)
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

    def _changes(self, name: str) -> int:
        """Splats of which an attribute changes; positions never do."""
        return 0 if name == POSITION else len(self._codes[name])

    def _absorb(self, name: str) -> bool:
        before = self._depth[name]
        while (part := self._waiting.pop((name, self._depth[name]), None)) is not None:
            codes = self._codes[name]
            self._codes[name] = (codes << np.uint32(part.bits)) | part.unpack(len(codes))
            self._depth[name] += 1
        return self._depth[name] > before

    def values(self) -> dict[str, Change]:
        """Column of :class:`Splats` -> change, at the depths there are."""
        out: dict[str, Change] = {}
        for book in self._books:
            name = book.attribute
            if name in _PLAIN and len(self._codes[name]):
                values = book.lookup(self._codes[name], self._depth[name])
                if name == "alpha":
                    values = alpha_logits(values)
                column = _PLAIN[name]
                out[column] = self._change(name, values[:, 0] if column == "logit_opacities" else values)
        bands = [name for name in SH_REST_ATTRIBUTES if name in self._books.attributes]
        if bands and len(self._codes[bands[0]]):
            parts = [self._books[name].lookup(self._codes[name], self._depth[name]) for name in bands]
            rest = np.concatenate(parts, axis=1).reshape(len(parts[0]), SH_REST_OF_DEGREE[len(bands)], 3)
            out["sh_rest"] = self._change(bands[0], rest)
        return out

    def _change(self, attribute: str, values: F32) -> Change:
        return Change(
            self.ids[self.changed[attribute]].astype(np.intp), np.ascontiguousarray(values), self._frames[attribute]
        )


def update_ids(payload: bytes | memoryview) -> Ids:
    """Only the ids [n] of an update's LoD 0. Raises :class:`DecodeError`."""
    return _parts(payload).ids


@dataclass(frozen=True)
class _Parts:
    """An update's LoD 0, cut up."""

    ids: Ids
    attributes: int
    masks: memoryview
    ramps: memoryview
    codes: memoryview


def _parts(payload: bytes | memoryview) -> _Parts:
    view = memoryview(payload)
    if len(view) < _HEAD.size:
        raise DecodeError(f"update: {len(view)} bytes are too few")
    version, attributes, splats, *sizes = _HEAD.unpack_from(view)
    if version != UPDATE_VERSION or splats > MAX_TILE_SPLATS or sum(sizes) > len(view) - _HEAD.size:
        raise DecodeError(
            f"update: version {version}, {splats} splats, {sizes} bytes of ids, masks and ramps; beyond bounds"
        )
    at, cut = _HEAD.size, []
    for size in sizes:
        cut.append(view[at : at + size])
        at += size
    ids = decode_ids(cut[0], what="update's ids", expected=splats)
    return _Parts(ids, attributes, cut[1], cut[2], view[at:])


def update_parts(payload: bytes | memoryview) -> dict[str, int]:
    """Bytes of an update's LoD 0 by what they tell. Raises :class:`DecodeError`."""
    parts = _parts(payload)
    named = {"masks": len(parts.masks), "ramps": len(parts.ramps), "base codes": len(parts.codes)}
    return {"heads": _HEAD.size, "ids": len(payload) - _HEAD.size - sum(named.values())} | named


def _opened(
    payload: bytes | memoryview, books: CodebookSet
) -> tuple[Ids, dict[str, NDArray[np.bool_]], dict[str, U8], dict[str, U32]]:
    """Ids, what changed of each attribute, in how many frames, and base codes."""
    parts = _parts(payload)
    if parts.attributes != len(books):
        raise DecodeError(f"update: has {parts.attributes} attributes, the codebooks {len(books)}")
    row = (len(parts.ids) + 7) // 8
    bits = np.frombuffer(unsqueeze(parts.masks, row * len(books), "update: masks"), np.uint8)
    masks = np.unpackbits(bits.reshape(len(books), row), axis=1, count=len(parts.ids), bitorder="little").astype(bool)
    changed = dict(zip(books.attributes, masks, strict=True))
    bands = [changed[name] for name in SH_REST_ATTRIBUTES if name in changed]
    if any(not np.array_equal(band, bands[0]) for band in bands):
        raise DecodeError("update: bands of harmonics change for different splats")
    sizes = {b.attribute: packed_bytes(int(changed[b.attribute].sum()), b.layer_bits[0]) for b in books}
    packed, at, codes = unsqueeze(parts.codes, sum(sizes.values()), "update: base codes"), 0, {}
    for book in books:
        end = at + sizes[book.attribute]
        part = PackedCodes(packed[at:end], book.layer_bits[0])
        codes[book.attribute] = part.unpack(int(changed[book.attribute].sum()))
        at = end
    return parts.ids, changed, _frames(parts.ramps, changed), codes


def _frames(ramps: memoryview, changed: Masks) -> dict[str, U8]:
    """Attribute -> in how many frames each of its changes is made. Raises :class:`DecodeError`."""
    out = {name: np.full(int(mask.sum()), AT_ONCE, np.uint8) for name, mask in changed.items()}
    if not len(ramps):
        return out
    ramped = [name for name in changed if name in _RAMPED]
    told = np.frombuffer(unsqueeze(ramps, sum(len(out[name]) for name in ramped), "update: ramps"), np.uint8)
    if told.max(initial=0) >= LONGEST_RAMP:
        raise DecodeError(f"update: a ramp of {int(told.max()) + 1} frames; {LONGEST_RAMP} are the most")
    at = 0
    for name in ramped:
        end = at + len(out[name])
        out[name] = told[at:end] + np.uint8(1)
        at = end
    return out
