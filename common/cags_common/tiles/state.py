"""What a decoder holds of one tile."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy

import numpy as np
from numpy.typing import NDArray

from cags_common.coding.packing import U32, PackedCodes
from cags_common.coding.rans import U8
from cags_common.errors import DecodeError
from cags_common.geometry import F32
from cags_common.motion.apply import Steps
from cags_common.splats import Ids, Splats
from cags_common.tiles.contexts import decode_codes, with_layer
from cags_common.tiles.dequantise import Dequantiser, FreshLayers
from cags_common.tiles.kinds import TileKind
from cags_common.tiles.lod import MAX_POSITION_LAYERS, POSITION, LodLayer, depths_at
from cags_common.tiles.payloads import BaseTile, decode_layer, decode_position_layer


class TileState:
    """One tile: its base, and enhancement layers that may come in any order.

    An attribute is decoded to its *depth*: the number of layers there without a gap. Layers are unpacked when
    :meth:`dequantise` needs them. Not thread-safe; different tiles may be decoded in different threads.
    """

    kind = TileKind.LOOKS

    def __init__(
        self,
        base: BaseTile,
        dequantiser: Dequantiser,
        lod_order: Sequence[LodLayer],
        step_tables: Steps | None = None,
    ) -> None:
        """``step_tables`` are units of motion by the base code of scale."""
        self.steps = None if step_tables is None else _steps(base, step_tables)
        """Units of the splats' motion; None in bundles without any."""
        self.base = base
        self._dequantise, self._order = dequantiser, tuple(lod_order)
        self._books = dequantiser.books  # which may get further layers
        self._codes: U32 | None = None
        self._fresh: dict[str, list[PackedCodes]] = {name: [layer] for name, layer in base.layers.items()}
        self._positions = _Positions(base.grid.layers)
        self._depth = dict.fromkeys(self._books.attributes, 0)
        self._prefixes: dict[str, U8] = {}
        """Attribute -> codes [n] of the depth there is, while a further layer is coded by them."""
        self._waiting: dict[tuple[str, int], bytes] = {}

    def __len__(self) -> int:
        return len(self.base)

    @property
    def ids(self) -> Ids:
        """Ids [n], ascending."""
        return self.base.ids

    @property
    def means(self) -> F32:
        """Positions [n, 3] as LoD 0 tells them, world, metres; :meth:`dequantise` gives those of all levels."""
        return self.base.means

    @property
    def lod(self) -> int:
        """Highest LoD up to which everything has come."""
        for level, item in enumerate(self._order):
            if self.depth(item.attribute) < item.layer:
                return level
        return len(self._order)

    def depth(self, attribute: str) -> int:
        """Enhancement layers of ``attribute`` that are decoded, from the base on without a gap; those that the tile
        does not have count as such.
        """
        return self._positions.depth if attribute == POSITION else self._depth[attribute]

    def add_layer(self, lod: int, payload: bytes | memoryview) -> bool:
        """Take LoD ``lod`` >= 1.

        Returns whether a depth rose (a layer below may be missing still). Raises :class:`DecodeError`.
        """
        if not 1 <= lod <= len(self._order):
            raise DecodeError(f"tile: LoD {lod} is outside 1 to {len(self._order)}")
        item = self._order[lod - 1]
        if item.attribute == POSITION:
            return self._positions.add(item.layer, payload, len(self))
        if item.layer <= self._depth[item.attribute]:
            return False
        self._books[item.attribute].bits_of(item.layer)  # which refuses one before its codebook
        self._waiting[item.attribute, item.layer] = bytes(payload)
        return self._absorb(item.attribute)

    @property
    def grows(self) -> bool:
        """Whether a further level may bring more splats: never, all come with the base."""
        return False

    def fork(self) -> TileState:
        """Another state of what has come; what is added to one of the two does not change the other."""
        other = copy(self)
        other._fresh = {name: list(parts) for name, parts in self._fresh.items()}
        other._depth, other._waiting, other._prefixes = dict(self._depth), dict(self._waiting), dict(self._prefixes)
        other._positions = self._positions.fork()
        return other

    def reduced(self, lods: int) -> TileState:
        """Another state, of LoDs 0 .. ``lods`` - 1 alone, all of which have come."""
        other = self.fork()
        other._waiting.clear()
        kept = depths_at(self._order, lods - 1)
        other._positions.keep(kept.get(POSITION, 0))
        codes = None if self._codes is None else self._codes.copy()
        for row, name in enumerate(self._depth):
            depth = kept.get(name, 0)
            merged = self._depth[name] + 1 - len(self._fresh[name])  # layers that the codes hold
            other._fresh[name] = self._fresh[name][: max(depth + 1 - merged, 0)]
            other._depth[name] = depth
            if name in other._prefixes:
                lost = sum(self._books[name].layer_bits[depth + 1 : self._depth[name] + 1])
                other._prefixes[name] = self._prefixes[name] >> np.uint8(lost)
            if codes is not None:
                codes[row] >>= np.uint32(sum(self._books[name].layer_bits[depth + 1 : merged]))
        other._codes = codes
        return other

    def dequantise(self, into: Splats | None = None) -> Splats:
        """The tile's splats [n] at the depths there are, in the order of ``base.ids``; in ``into`` if given."""
        fresh = [FreshLayers(self._depth[name] + 1 - len(parts), tuple(parts)) for name, parts in self._fresh.items()]
        means = self._positions.of(self.base)
        splats, self._codes = self._dequantise(means, self._codes, fresh, into)
        self._fresh = {name: [] for name in self._fresh}
        return splats

    def _absorb(self, attribute: str) -> bool:
        before = self._depth[attribute]
        while (payload := self._waiting.pop((attribute, self._depth[attribute] + 1), None)) is not None:
            self._fresh[attribute].append(self._decoded(attribute, self._depth[attribute] + 1, payload))
            self._depth[attribute] += 1
        return self._depth[attribute] > before

    def _decoded(self, attribute: str, layer: int, payload: bytes) -> PackedCodes:
        """Codes of the next ``layer`` of an attribute. Raises :class:`DecodeError`."""
        book, count = self._books[attribute], len(self)
        bits, model, more = book.layer_bits[layer], book.model(layer), any(book.models[layer + 1 :])
        if model is None and not more:
            return decode_layer(payload, count, bits)
        known = self._prefixes.get(attribute)
        prefixes = self.base.layers[attribute].unpack(count).astype(np.uint8) if known is None else known
        if model is None:
            packed = decode_layer(payload, count, bits)
            codes = packed.unpack(count).astype(np.uint8)
        else:
            codes, packed = decode_codes(payload, model, prefixes, self.base.near)
        if more:
            self._prefixes[attribute] = with_layer(prefixes, codes, bits)
        return packed


class _Positions:
    """Layers of a tile's positions."""

    def __init__(self, layers: int) -> None:
        self._layers = layers
        self._bits: dict[int, NDArray[np.uint8]] = {}
        """Layer -> [n, 3]."""

    @property
    def depth(self) -> int:
        """Layers without a gap; without end where the tile has no more."""
        come = self._come
        return MAX_POSITION_LAYERS if come == self._layers else come

    @property
    def _come(self) -> int:
        return next(layer for layer in range(self._layers + 1) if layer + 1 not in self._bits)

    def add(self, layer: int, payload: bytes | memoryview, count: int) -> bool:
        """Take a ``layer`` of ``count`` splats; whether the depth rose. Raises :class:`DecodeError`."""
        if layer > self._layers:
            if len(payload):
                raise DecodeError(f"tile: has layer {layer} of positions, but its base says {self._layers}")
            return False
        if layer in self._bits:
            return False
        before, self._bits[layer] = self._come, decode_position_layer(payload, count)
        return self._come > before

    def of(self, base: BaseTile) -> F32:
        """Positions [n, 3] at the depth there is, world, metres."""
        come = self._come
        return base.refined([self._bits[layer] for layer in range(1, come + 1)]) if come else base.means

    def keep(self, layers: int) -> None:
        """Only the first ``layers``."""
        self._bits = {layer: bits for layer, bits in self._bits.items() if layer <= layers}

    def fork(self) -> _Positions:
        """An independent copy."""
        other = copy(self)
        other._bits = dict(self._bits)
        return other


def _steps(base: BaseTile, tables: Steps) -> Steps:
    codes = base.layers["scale"].unpack(len(base))
    return Steps(tables.moves[codes], tables.turns[codes])
