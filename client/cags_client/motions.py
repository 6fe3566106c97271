"""Tiles of motion and of updates that a client holds of one group of frames, besides its looks.

A chunk of motion is decoded while it may be shown. Once a later chunk of the same looks is, or nothing of the looks is
left, only its payloads stay, which are small, for showing earlier frames again. A chunk that comes before the looks
that it moves waits undecoded, for it can be checked against nothing.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from cags_client.shown import Held
from cags_client.waiting import Key
from cags_common.codecs import MotionTile
from cags_common.errors import DecodeError
from cags_common.geometry import F32
from cags_common.motion.chunk import LEVELS, Chunk, read_looks
from cags_common.splats import Ids, Splats
from cags_common.updates import UpdateState


@dataclass(eq=False)
class HeldMotion:
    """One tile of motion: its payloads, and what is decoded of them."""

    key: Key
    looks: Key
    state: MotionTile | None
    """None once it is past."""
    payloads: dict[int, bytes]
    """By level."""
    shown_lod: int = -1

    @property
    def lods(self) -> int:
        """Levels that are held, from the lowest on without a gap."""
        return next((level for level in range(LEVELS) if level not in self.payloads), LEVELS)

    @property
    def bytes(self) -> int:
        """Of all payloads."""
        return sum(map(len, self.payloads.values()))

    def opened(self) -> MotionTile:
        """Decoded anew from the payloads, but for levels that are damaged. Raises :class:`DecodeError`."""
        state = MotionTile(self.payloads[0])
        for level, payload in sorted(self.payloads.items()):
            if level:
                with suppress(DecodeError):
                    state.add_layer(level, payload)
        return state


@dataclass(eq=False)
class HeldUpdate:
    """One update: what is decoded of it."""

    key: Key
    state: UpdateState
    shown_lod: int = -1
    ids_of: dict[str, NDArray[np.intp]] = field(default_factory=dict)
    """Column of splats -> ids that it changes; known once it is shown."""

    @property
    def lods(self) -> int:
        """Levels that are decoded, from the base on without a gap."""
        return self.state.lod + 1


AnyHeld: TypeAlias = Held | HeldMotion | HeldUpdate
UpdateValues: TypeAlias = dict[str, tuple[NDArray[np.intp], F32]]


@dataclass(eq=False)
class Staged:
    """A tile that the display may show, at the levels that there were."""

    held: AnyHeld
    lod: int
    value: tuple[Ids, Splats] | UpdateValues | Chunk


def staged_from(held: AnyHeld) -> Staged | None:
    """What is to be shown of a tile, at the levels there are; None for motion that is past."""
    if isinstance(held, Held):
        state = held.tile.state
        return Staged(held, state.lod, (state.ids, state.dequantise()))
    if isinstance(held, HeldUpdate):
        return Staged(held, held.state.lod, held.state.values())
    motion = held.state
    if motion is None:
        return None
    chunk = motion.chunk
    if motion.lod < LEVELS - 1:  # a further level is added in place, while this may be on display
        moves, turns = (None if part is None else part.copy() for part in (chunk.moves, chunk.turns))
        chunk = replace(chunk, moves=moves, turns=turns)
    return Staged(held, motion.lod, chunk)


def reopened(held: HeldMotion) -> MotionTile | DecodeError:
    """The tile decoded from its payloads, or why it cannot be."""
    try:
        return held.opened()
    except DecodeError as error:
        return error


def named(key: Key) -> str:
    """The tile in an error."""
    return f"tile {key[1]} of frame {key[0]}"


def looks_of(payload: memoryview | None) -> Key | None:
    """The looks that LoD 0 of a tile of motion moves; None where there is none, or it cannot be read."""
    if payload is None:
        return None
    try:
        return read_looks(payload)
    except DecodeError:
        return None


class Motions:
    """Tiles of motion by the looks that they move, and those that wait for their looks."""

    def __init__(self) -> None:
        self._of: dict[Key, dict[int, HeldMotion]] = {}
        self._orphans: dict[Key, set[Key]] = {}
        self._looks_of: dict[Key, Key] = {}  # of those that wait

    def add(self, held: HeldMotion) -> HeldMotion | None:
        """Take a tile in; the one of the same looks and frame that it takes the place of."""
        of = self._of.setdefault(held.looks, {})
        before = of.get(held.key[0])
        of[held.key[0]] = held
        return before

    def discard(self, held: HeldMotion) -> None:
        """Forget a tile."""
        of = self._of.get(held.looks, {})
        if of.get(held.key[0]) is held:
            del of[held.key[0]]

    def of(self, looks: Key) -> list[HeldMotion]:
        """All that move tile ``looks``."""
        return list(self._of.get(looks, {}).values())

    def at(self, looks: Key, start: int) -> HeldMotion | None:
        """The one that moves tile ``looks`` from media frame ``start`` on."""
        return self._of.get(looks, {}).get(start)

    def looks(self) -> list[Key]:
        """Tiles that move."""
        return list(self._of)

    def wait(self, key: Key, looks: Key) -> None:
        """Tile ``key`` waits for ``looks``."""
        self._orphans.setdefault(looks, set()).add(key)
        self._looks_of[key] = looks

    def give_up(self, key: Key) -> None:
        """Tile ``key`` waits no more."""
        looks = self._looks_of.pop(key, None)
        if looks is not None:
            waiting = self._orphans[looks]
            waiting.discard(key)
            if not waiting:
                del self._orphans[looks]

    def come(self, looks: Key) -> list[Key]:
        """``looks`` have come: the tiles that waited for them, in order."""
        keys = sorted(self._orphans.get(looks, ()))
        for key in keys:
            self.give_up(key)
        return keys
