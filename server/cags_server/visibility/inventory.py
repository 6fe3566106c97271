"""The server's view of a client's inventory: delivered layers and layers in flight."""

from __future__ import annotations

from dataclasses import dataclass

from cags_protocol.wire.messages import TileLayers

Key = tuple[int, int]


@dataclass(slots=True)
class _Layers:
    delivered: int = 0  # bit L: LoD L arrived
    travelling: int = 0  # bit L: LoD L is queued or in flight


def _run(mask: int) -> int:
    """Number of low bits set without a gap."""
    return (~mask & (mask + 1)).bit_length() - 1


class ClientInventory:
    """Layers that a client holds, by (media frame, tile). If LoDs are not incremental, each includes all below it."""

    def __init__(self, *, layered: bool = True) -> None:
        self._layered = layered
        self._tiles: dict[Key, _Layers] = {}

    def queued(self, message: TileLayers) -> None:
        """Layers were queued for sending."""
        held = self._tiles.setdefault((message.frame, message.tile), _Layers())
        held.travelling |= self._bits(message)

    def delivered(self, message: TileLayers) -> None:
        """The client has acknowledged layers."""
        held = self._tiles.setdefault((message.frame, message.tile), _Layers())
        held.travelling &= ~self._bits(message)
        held.delivered |= self._bits(message)

    def hold(self, frame: int, tile: int, lods: int) -> None:
        """The client holds LoDs 0 .. ``lods`` - 1 of a tile."""
        self._tiles.setdefault((frame, tile), _Layers()).delivered |= (1 << lods) - 1

    def dropped(self, message: TileLayers) -> None:
        """Layers will not arrive."""
        held = self._tiles.get((message.frame, message.tile))
        if held is not None:
            held.travelling &= ~self._bits(message)

    def reduced(self, frame: int, tile: int, lods: int) -> None:
        """The client keeps only LoDs 0 .. ``lods`` - 1 of a tile."""
        held = self._tiles.get((frame, tile))
        if held is not None:
            held.delivered &= (1 << lods) - 1

    def depth(self, frame: int, tile: int) -> int:
        """Number of LoDs from 0 without a gap that the client holds or that are in flight."""
        return _run(self.mask(frame, tile))

    def delivered_depth(self, frame: int, tile: int) -> int:
        """Number of LoDs from 0 without a gap that have arrived."""
        held = self._tiles.get((frame, tile))
        return 0 if held is None else _run(held.delivered)

    def holds(self, frame: int, tile: int, lod: int) -> bool:
        """Whether one LoD has arrived or is in flight."""
        return bool(self.mask(frame, tile) >> lod & 1)

    def mask(self, frame: int, tile: int) -> int:
        """Bit L is set for each LoD L that has arrived or is in flight."""
        held = self._tiles.get((frame, tile))
        return 0 if held is None else held.delivered | held.travelling

    def forget_before(self, first: int) -> None:
        """Forget tiles of frames before ``first``."""
        for key in [key for key in self._tiles if key[0] < first]:
            del self._tiles[key]

    def clear(self) -> None:
        """The client holds nothing any more."""
        self._tiles.clear()

    def _bits(self, message: TileLayers) -> int:
        below = (1 << message.from_lod) - 1 if self._layered else 0
        return ((1 << message.to_lod) - 1) & ~below

    def __len__(self) -> int:
        return len(self._tiles)
