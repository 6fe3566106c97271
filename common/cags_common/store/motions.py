"""Tiles of motion and updates of one group of frames.

A chunk of motion is decoded while it may be shown. When a later chunk of the same looks is shown, or the looks are
gone, only its payloads stay, which are small, so that earlier frames can be shown again. A chunk that arrives before
its looks waits undecoded, because it cannot be checked.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from cags_common.bundle.codecs import MotionDecoder, TileDecoder, UpdateDecoder
from cags_common.errors import DecodeError
from cags_common.motion.apply import Steps
from cags_common.motion.chunk import LEVELS, Chunk
from cags_common.motion.parts import in_motion
from cags_common.splats import Ids, Splats
from cags_common.store.shown import StoredLooks
from cags_common.store.tile_decode import First, Key, Opener, OpenMotion
from cags_common.store.versions import Version, Versions
from cags_common.tiles.updates import Change


@dataclass(frozen=True, slots=True)
class KeptPayload:
    """A level of motion, and the last mark before it."""

    since: int
    data: bytes | memoryview


@dataclass(eq=False)
class StoredMotion:
    """One tile of motion: its payloads and their decoded state."""

    key: Key
    looks: Key
    versions: Versions[MotionDecoder] | None
    """None after it has expired."""
    payloads: dict[int, KeptPayload]
    """By level."""
    shown_lod: int = -1

    @property
    def lods(self) -> int:
        """Number of held levels, from the lowest on without a gap."""
        return next((level for level in range(LEVELS) if level not in self.payloads), LEVELS)

    def opened(self, opener: Opener, looks: TileDecoder, floor: float) -> Versions[MotionDecoder] | DecodeError:
        """Decode the payloads again, except damaged levels; everything before mark ``floor`` becomes one version.

        ``looks`` are those that move.
        """
        first, *_ = opener.opened([First(self.key, 0, memoryview(self.payloads[0].data), looks)])
        if isinstance(first, DecodeError):
            return first
        assert isinstance(first, OpenMotion)
        since = self.payloads[0].since
        versions = Versions(first.state, since)
        for level, kept in sorted(self.payloads.items(), key=lambda item: (item[1].since, item[0])):
            if level:
                at = kept.since if kept.since >= floor else since
                with suppress(DecodeError):
                    versions.writable(at).add_layer(level, kept.data)
                    versions.touch()
        return versions


@dataclass(eq=False)
class StoredUpdate:
    """One update and its decoded levels."""

    key: Key
    versions: Versions[UpdateDecoder]
    shown_lod: int = -1
    ids_of: dict[str, NDArray[np.intp]] = field(default_factory=dict)
    """Column of splats -> ids that the update changes; known after it was shown."""

    @property
    def lods(self) -> int:
        """Number of decoded levels, from the base on without a gap."""
        return self.versions.newest.lod + 1


StoredTile: TypeAlias = StoredLooks | StoredMotion | StoredUpdate
UpdateValues: TypeAlias = dict[str, Change]


@dataclass(frozen=True, eq=False)
class LooksValue:
    """The splats of a tile of looks."""

    ids: Ids  # [n]
    splats: Splats  # [n]
    steps: Steps | None
    """Units of their motion; None in bundles without motion."""
    grows: bool
    """Whether further levels may add splats."""


@dataclass(frozen=True, eq=False)
class Staged:
    """A tile ready for display, at the levels received before the mark after ``since``."""

    held: StoredTile
    since: int
    lod: int
    value: LooksValue | UpdateValues | Chunk


def to_stage(held: StoredTile) -> list[Callable[[], Staged]]:
    """Functions that stage a tile, one per version; none for expired motion.

    Their results never change, because nothing is added to a version that was handed out.
    """
    if isinstance(held, StoredLooks):
        return [partial(_staged_looks, held, version) for version in held.versions.fresh()]
    if isinstance(held, StoredUpdate):
        return [partial(_staged_update, held, version) for version in held.versions.fresh()]
    return [partial(_staged_motion, held, v) for v in held.versions.fresh()] if held.versions is not None else []


def staged(make: Callable[[], Staged]) -> Staged:
    """What ``make`` makes."""
    return make()


def _staged_looks(held: StoredLooks, version: Version[TileDecoder]) -> Staged:
    state = version.handed_out()
    splats = state.dequantise()
    return Staged(held, version.since, state.lod, LooksValue(state.ids, splats, state.steps, state.grows))


def _staged_update(held: StoredUpdate, version: Version[UpdateDecoder]) -> Staged:
    state = version.handed_out()
    return Staged(held, version.since, state.lod, state.values())


def _staged_motion(held: StoredMotion, version: Version[MotionDecoder]) -> Staged:
    state = version.handed_out()
    chunk = state.chunk
    in_motion(chunk)  # computed here, off the display path, and kept
    return Staged(held, version.since, state.lod, chunk)


def named(key: Key) -> str:
    """Name of the tile for errors."""
    return f"tile {key[1]} of frame {key[0]}"


class Motions:
    """Tiles of motion by their looks, and tiles that wait for their looks."""

    def __init__(self) -> None:
        self._of: dict[Key, dict[int, StoredMotion]] = {}
        self._orphans: dict[Key, set[Key]] = {}
        self._looks_of: dict[Key, Key] = {}  # of those that wait

    def add(self, held: StoredMotion) -> StoredMotion | None:
        """Add a tile; returns the one of the same looks and frame that it replaces."""
        of = self._of.setdefault(held.looks, {})
        before = of.get(held.key[0])
        of[held.key[0]] = held
        return before

    def discard(self, held: StoredMotion) -> None:
        """Forget a tile."""
        of = self._of.get(held.looks, {})
        if of.get(held.key[0]) is held:
            del of[held.key[0]]

    def of(self, looks: Key) -> list[StoredMotion]:
        """All motion of tile ``looks``."""
        return list(self._of.get(looks, {}).values())

    def at(self, looks: Key, start: int) -> StoredMotion | None:
        """The motion of tile ``looks`` from media frame ``start`` on."""
        return self._of.get(looks, {}).get(start)

    def looks(self) -> list[Key]:
        """All tiles of motion."""
        return list(self._of)

    def wait(self, key: Key, looks: Key) -> None:
        """Note that tile ``key`` waits for ``looks``."""
        self._orphans.setdefault(looks, set()).add(key)
        self._looks_of[key] = looks

    def give_up(self, key: Key) -> None:
        """Note that tile ``key`` no longer waits."""
        looks = self._looks_of.pop(key, None)
        if looks is not None:
            waiting = self._orphans[looks]
            waiting.discard(key)
            if not waiting:
                del self._orphans[looks]

    def come(self, looks: Key) -> list[Key]:
        """``looks`` have arrived: returns the tiles that waited for them, in order."""
        keys = sorted(self._orphans.get(looks, ()))
        for key in keys:
            self.give_up(key)
        return keys
