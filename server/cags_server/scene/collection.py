"""The scenes of one server: a bundle, or all bundles of a folder, opened when somebody watches them."""

from __future__ import annotations

import logging
import re
import threading
from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from weakref import WeakValueDictionary

from cags_common.bundle import BundleReader, Manifest
from cags_common.bundle.first_view import thumbnail
from cags_common.bundle.reader import MANIFEST_NAME
from cags_common.bundle.store import local_path
from cags_common.errors import CagsError, ConfigError
from cags_common.raster.base import Rasteriser
from cags_common.runtime.recent import Recent
from cags_server.scene.decoded_tiles import DECODED_BYTES
from cags_server.scene.library import SceneLibrary

MAX_SCENES = 1000
IDLE_SCENES = 4
"""Scenes that stay ready to be watched though nobody watches them."""
THUMBNAIL_BYTES = 16 << 20
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,79}", re.ASCII)

log = logging.getLogger(__name__)


class UnknownSceneError(CagsError):
    """A scene was asked for that is not there, or none where there are several."""


@dataclass(frozen=True, slots=True)
class SceneEntry:
    """One scene in a list."""

    name: str
    """In addresses."""
    title: str
    seconds: float
    frames: int
    bytes: int
    """Total size of what a viewer may be sent."""


class Collection:
    """Scenes by name. Safe to use from several threads."""

    def __init__(
        self,
        readers: dict[str, BundleReader],
        rasteriser: Rasteriser,
        folder: Path | None = None,
        *,
        decoded_bytes: int = DECODED_BYTES,
    ) -> None:
        """``folder``: where the bundles lie, of a server that has several; None: there is one, which needs no name.
        ``decoded_bytes`` bound the decoded tiles that are kept of each scene.
        """
        self._readers, self._rasteriser, self.folder = dict(readers), rasteriser, folder
        self._decoded_bytes = decoded_bytes
        self._watched = WeakValueDictionary[str, SceneLibrary]()
        self._idle = OrderedDict[str, SceneLibrary]()  # least recently watched first
        self._thumbnails = Recent[str, bytes](THUMBNAIL_BYTES)
        self._lock, self._drawing = threading.Lock(), threading.Lock()

    @classmethod
    def of(cls, library: SceneLibrary) -> Collection:
        """One scene that is open already."""
        name = scene_name(library.manifest.name)
        found = cls({name: library.reader}, library.rasteriser)
        found._keep(name, library)
        return found

    @classmethod
    def open(
        cls,
        url: str,
        rasteriser: Callable[[], Rasteriser],
        *,
        may_be_empty: bool = False,
        decoded_bytes: int = DECODED_BYTES,
    ) -> Collection:
        """The bundle at ``url``, or all bundles in that folder; ``rasteriser()`` is asked for once they are found.
        ``decoded_bytes`` bound the decoded tiles that are kept of each scene.

        Raises :class:`BundleError` or :class:`DecodeError` for one bundle and for a folder without any, unless it
        ``may_be_empty``. Bundles of a folder that cannot be read are left out, with a line in the log.
        """
        folder = local_path(url)
        several = folder is not None and folder.is_dir() and not (folder / MANIFEST_NAME).is_file()
        places = _bundles(folder) if several and folder is not None else []
        if folder is None or not (places or (several and may_be_empty)):
            reader = BundleReader.open(url)
            return cls({scene_name(reader.manifest.name): reader}, rasteriser(), decoded_bytes=decoded_bytes)
        if len(places) > MAX_SCENES:
            raise ConfigError(f"bundle = {url}: holds {len(places)} bundles; at most {MAX_SCENES} are served")
        collection = cls({}, rasteriser(), folder, decoded_bytes=decoded_bytes)
        for place in places:
            try:
                collection.add(place)
            except CagsError as error:
                log.warning("%s is left out: %s", place, error)
        return collection

    @property
    def several(self) -> bool:
        """Whether there is a list to choose from, whatever its length at present."""
        return self.folder is not None

    @property
    def manifests(self) -> Sequence[Manifest]:
        """The manifests of all scenes."""
        return [reader.manifest for reader in list(self._readers.values())]

    @property
    def title(self) -> str:
        """Title to display: the scene's name, or the number of scenes."""
        manifests = self.manifests
        return f"{len(manifests)} scenes" if self.several else manifests[0].name

    @property
    def decoded_bytes(self) -> int:
        """Decoded tiles kept of all scenes that are open."""
        with self._lock:
            return sum(library.decoded.nbytes for library in self._watched.values())

    def forget_decoded(self) -> None:
        """Drop the decoded tiles of all open scenes; meant for a server that nobody watches."""
        with self._lock:
            libraries = list(self._watched.values())
        for library in libraries:
            library.decoded.forget()

    def add(self, place: Path) -> str:
        """Take in the bundle in a folder; its name. Raises :class:`BundleError` or :class:`DecodeError`."""
        reader = BundleReader.open(str(place))
        with self._lock:
            name = unused(scene_name(place.name), self._readers)
            self._readers[name] = reader
        return name

    def entries(self) -> list[SceneEntry]:
        """The list, by title."""
        found = [_entry(name, reader.manifest) for name, reader in list(self._readers.items())]
        return sorted(found, key=lambda entry: (entry.title.casefold(), entry.name))

    def library(self, name: str | None) -> SceneLibrary:
        """The scene to watch, opened where it was not, which may read from its store; None: the only one.

        Raises :class:`UnknownSceneError`, or :class:`CagsError` where the bundle cannot be read.
        """
        name = self._known(name)
        library = self._opened(name)
        if library is None:  # without the lock: a slow store holds up nobody who wants another scene
            opened = SceneLibrary(self._readers[name], self._rasteriser, self._decoded_bytes)
            with self._lock:
                library = self._watched.setdefault(name, opened)
        self._keep(name, library)
        return library

    def is_open(self, name: str | None) -> bool:
        """Whether :meth:`library` answers from memory. Raises :class:`UnknownSceneError`."""
        return self._opened(self._known(name)) is not None

    def _opened(self, name: str) -> SceneLibrary | None:
        with self._lock:
            return self._watched.get(name)

    def manifest(self, name: str | None) -> Manifest:
        """The manifest of scene ``name``; None: of the only scene. Raises :class:`UnknownSceneError`."""
        return self._readers[self._known(name)].manifest

    def thumbnail(self, name: str | None) -> bytes:
        """A small JPEG of a scene's first view: the bundle's own, else drawn here, which takes a moment.

        Raises :class:`UnknownSceneError`, or :class:`CagsError` where the bundle cannot be read.
        """
        name = self._known(name)
        with self._drawing:  # one at a time: a gallery asks for all of them at once
            known = self._thumbnails.get(name)
            if known is None:
                known = self._readers[name].thumbnail() or self._drawn(name)
                self._thumbnails.put(name, known, len(known))
            return known

    def _drawn(self, name: str) -> bytes:
        reader = self._readers[name]
        return thumbnail(self._rasteriser.load(reader.source(0).splats), reader.manifest)

    def _keep(self, name: str, library: SceneLibrary) -> None:
        """Whoever watches keeps a scene open; beyond that the last few stay."""
        with self._lock:
            self._watched[name] = self._idle[name] = library
            self._idle.move_to_end(name)
            while len(self._idle) > IDLE_SCENES:
                self._idle.popitem(last=False)

    def _known(self, name: str | None) -> str:
        if name is None and not self.several:
            return next(iter(self._readers))
        if name is None:
            raise UnknownSceneError("this server has a folder of scenes: name one, ?scene=NAME or --scene NAME")
        if name not in self._readers:
            raise UnknownSceneError(f"there is no scene {name[:80]!r} here; the server's own page lists those that are")
        return name


def scene_name(text: str) -> str:
    """``text``, a title or a file's name, as a name for addresses: letters, digits, dots, dashes and underscores."""
    plain = re.sub(r"[^A-Za-z0-9._-]+", "-", text.removesuffix(".cags").removesuffix(".bundle")).strip("-._")[:80]
    return plain if _NAME.fullmatch(plain) else "scene"


def _bundles(folder: Path) -> list[Path]:
    return sorted(path.parent for path in folder.glob(f"*/{MANIFEST_NAME}") if path.parent.name[0] != ".")


def unused(name: str, taken: dict[str, BundleReader]) -> str:
    """``name``, with a number where it is taken."""
    number, found = 1, name
    while found in taken:
        number += 1
        found = f"{name}-{number}"
    return found


def _entry(name: str, manifest: Manifest) -> SceneEntry:
    title = (manifest.view.title if manifest.view else "") or manifest.name
    size = sum(group.tiles.size_bytes for group in manifest.gofs)
    return SceneEntry(name, title, manifest.frames / manifest.fps, manifest.frames, size)
