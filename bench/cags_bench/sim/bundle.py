"""Bundles for simulated servers, with or without source frames.

A published folder (``cags-encode --publish``) has what a player needs, but no source frames. Its top level replaces
them: references are rendered from it, and pictures are compared with it.
"""

from __future__ import annotations

import json
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np

from cags_common.bundle import BundlePlayer, BundleReader, Manifest
from cags_common.bundle.manifest import MAX_MANIFEST_BYTES
from cags_common.bundle.reader import MANIFEST_NAME, naming
from cags_common.bundle.source import SourceDelta, SourceFrame
from cags_common.bundle.store import UrlStore
from cags_common.splats import Splats
from cags_common.tiles.svq import MAX_CODEBOOK_BYTES

SOURCE, TOP_LEVEL = "the source frames", "the bundle's top level"
"""The truth that pictures are compared with."""


def is_bundle(scene: str) -> bool:
    """Whether ``scene`` is a folder with a bundle, published or not, and not a scene to encode."""
    return (Path(scene) / MANIFEST_NAME).is_file()


def truth_of(bundle: Path) -> str:
    """:data:`SOURCE` or :data:`TOP_LEVEL`: the truth for pictures of ``bundle``."""
    return TOP_LEVEL if _published_codebooks(bundle) else SOURCE


def open_bundle(bundle: Path) -> BundleReader:
    """A reader of ``bundle``. Raises :class:`BundleError` or :class:`DecodeError` if it cannot be read."""
    codebooks = _published_codebooks(bundle)
    return PublishedReader.at(bundle, codebooks) if codebooks else BundleReader.open(str(bundle))


def _published_codebooks(bundle: Path) -> str:
    """Name of a published folder's codebooks; empty if ``bundle`` is not published or cannot be read."""
    try:
        table = json.loads((bundle / MANIFEST_NAME).read_bytes())
    except (OSError, ValueError):
        return ""
    published = table.get("published") if isinstance(table, dict) else None
    return str(published.get("codebooks", "")) if isinstance(published, dict) else ""


class PublishedReader(BundleReader):
    """Reader of a published folder. The splats of its top level are its source frames."""

    def __init__(self, store: UrlStore, manifest: Manifest, codebooks: bytes) -> None:
        super().__init__(store, replace(manifest, weights_crc=None), codebooks)  # weights are not published
        self._player = BundlePlayer(self)
        self._decoding = threading.RLock()
        self._newest: dict[int, SourceFrame] = {}  # cache of the last two frames

    @classmethod
    def at(cls, folder: Path, codebooks: str) -> PublishedReader:
        """Open ``folder`` with the codebooks in the file ``codebooks``.

        Raises :class:`BundleError` or :class:`DecodeError`, which name the folder.
        """
        with naming(str(folder)):
            store = UrlStore(str(folder))
            manifest = Manifest.from_json(store.read_all(MANIFEST_NAME, MAX_MANIFEST_BYTES))
            return cls(store, manifest, store.read_all(codebooks, MAX_CODEBOOK_BYTES))

    def source(self, frame: int) -> SourceFrame:
        """See :meth:`BundleReader.source`; all splats alive in ``frame``, with every layer."""
        with self._decoding:
            known = self._newest.pop(frame, None)
            if known is None:
                held = self._player.frame(frame)
                known = SourceFrame(held.ids, held.splats)
            self._newest = {**dict(list(self._newest.items())[-1:]), frame: known}
            return known

    def source_delta(self, frame: int) -> SourceDelta:
        """See :meth:`BundleReader.source_delta`."""
        with self._decoding:
            none = np.zeros(0, np.int32)
            if frame in self.manifest.gof_starts:
                now = self.source(frame)
                return SourceDelta(now.ids, now.splats, none)
            before, now = self.source(frame - 1), self.source(frame)
        removed = np.setdiff1d(before.ids, now.ids, assume_unique=True)
        changed = _changed(before, now)
        return SourceDelta(now.ids[changed], now.splats.take(changed), removed)


def _changed(before: SourceFrame, now: SourceFrame) -> np.ndarray:
    """Rows [n] of ``now`` that are new or differ in any value."""
    _, now_rows, before_rows = np.intersect1d(now.ids, before.ids, assume_unique=True, return_indices=True)
    same = np.ones(len(now_rows), bool)
    for new, old in zip(_arrays(now.splats), _arrays(before.splats), strict=True):
        same &= (new[now_rows] == old[before_rows]).reshape(len(now_rows), -1).all(axis=1)
    unchanged = np.zeros(len(now.ids), bool)
    unchanged[now_rows] = same
    return np.flatnonzero(~unchanged)


def _arrays(splats: Splats) -> list[np.ndarray]:
    return [array for _, array in splats.arrays()]
