"""Where a bundle is written: a folder of this machine, replaced as a whole, or another store, file by file.

Nothing but a bundle is ever replaced, and nothing changes before the first file is written.
"""

from __future__ import annotations

import glob
import logging
import os
import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import Any

from cags_common.bundle.quality import QUALITY_NAME
from cags_common.bundle.reader import CODEBOOKS_NAME, MANIFEST_NAME, THUMBNAIL_NAME
from cags_common.bundle.store import filesystem, remove_tree, written_folder
from cags_common.errors import BundleError, CagsError, OutputError

log = logging.getLogger(__name__)

SOURCE = "source"
"""The only folder within a bundle."""

_ONE_OF = "|".join(map(re.escape, (MANIFEST_NAME, CODEBOOKS_NAME, QUALITY_NAME, THUMBNAIL_NAME)))
_NAME = re.compile(
    rf"(?:{SOURCE}/)?gof_\d{{4,}}\.bin|(?P<new>\.)?(?:{_ONE_OF}|weights-[0-9a-f]{{8}}\.npz)(?(new)\.new)"
)
"""Names of a bundle's files, and of those that :func:`~cags_common.bundle.store.replace_files` writes first."""


class OutputFile:
    """A binary file open for writing. Every method raises :class:`OutputError` that names it."""

    def __init__(self, name: str, file: Any) -> None:
        self._name, self._file = name, file

    def __enter__(self) -> OutputFile:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def write(self, data: bytes) -> None:
        """Append ``data``."""
        with _writing(self._name):
            self._file.write(data)

    def close(self) -> None:
        """Write what is buffered, and close the file."""
        with _writing(self._name):
            self._file.close()

    def abandon(self) -> None:
        """Close a file that is deleted next: whether all of it could be written does not matter any more."""
        with suppress(Exception):
            self._file.close()


class Place(ABC):
    """Takes the files of one bundle; :meth:`finish` completes it, :meth:`discard` deletes what was written."""

    def __init__(self, url: str) -> None:
        self._url = url
        self._files: list[OutputFile] = []

    def open(self, name: str) -> OutputFile:
        """Open a file of the bundle for writing. Raises :class:`OutputError` or :class:`BundleError`."""
        shown = f"{self._url}/{name}"
        with _writing(shown):
            if not self._files:
                self._prepare()
            file = OutputFile(shown, self._open(name))
        self._files.append(file)
        return file

    def discard(self) -> None:
        """Delete every file that was written, and nothing else."""
        for file in self._files:
            file.abandon()
        self._remove()

    @abstractmethod
    def finish(self) -> None:
        """All files are closed: the bundle is complete. Raises :class:`OutputError` or :class:`BundleError`."""

    @abstractmethod
    def _prepare(self) -> None:
        """Make room for the first file."""

    @abstractmethod
    def _open(self, name: str) -> Any:
        """Open a file for writing, in any way that can fail."""

    @abstractmethod
    def _remove(self) -> None:
        """Delete the files that were opened; they are closed."""

    def _refuse(self, why: str) -> BundleError:
        return BundleError(f"{self._url}: {why}; give another name, nothing was overwritten")


def place_of(url: str) -> Place:
    """The place that ``url`` (a folder or an fsspec URL) names.

    Raises :class:`BundleError` if something is there that is not a bundle, and :class:`OutputError` if nothing can be
    written there, as far as that shows at once.
    """
    folder = written_folder(url)
    return _StorePlace(url) if folder is None else _FolderPlace(url, folder)


class _FolderPlace(Place):
    """A folder of this machine: written as a hidden sibling, which is renamed at the end."""

    def __init__(self, url: str, folder: Path) -> None:
        super().__init__(url)
        self._folder = folder
        self._scratch = folder.with_name(f".{folder.name}.partial-{os.getpid()}") if folder.name else folder
        with _writing(url):
            self._check()
            self._probe()

    def finish(self) -> None:
        """Rename the new folder to its name, in place of the old one."""
        with _writing(self._url):
            self._check()  # again, as writing may have taken hours
        old = self._folder.with_name(f".{self._folder.name}.replaced-{os.getpid()}")
        remove_tree(old)
        try:
            if self._folder.exists():
                self._folder.rename(old)
            self._scratch.rename(self._folder)
        except OSError as error:
            if old.exists() and not self._folder.exists():
                old.rename(self._folder)
            raise BundleError(f"{self._url}: cannot be put in place ({error.strerror})") from error
        remove_tree(old)

    def _check(self) -> None:
        """Refuse what cannot or must not be replaced by renaming another folder to its name."""
        folder = self._folder
        if folder.is_symlink():
            raise self._refuse("is a symbolic link that leads nowhere but in a circle")
        if folder.is_mount():
            raise BundleError(f"{self._url}: is a mount point, which cannot be replaced; name a new folder within it")
        if Path.cwd().is_relative_to(folder):
            raise BundleError(f"{self._url}: would replace the current folder; name a new folder within or beside it")
        above = next(parent for parent in folder.parents if parent.exists())
        if not above.is_dir():
            raise self._refuse(f"{above} is not a folder")
        for parent in folder.parents:
            if all((parent / name).is_file() for name in (MANIFEST_NAME, CODEBOOKS_NAME)):
                raise self._refuse(f"lies inside the bundle {parent}, which could not be replaced any more")
        if not folder.exists():
            return
        if not folder.is_dir():
            raise self._refuse("exists and is not a bundle but a file")
        names = _names(_listed(folder), lambda: _listed(folder / SOURCE))
        foreign = _foreign(names)
        if names and MANIFEST_NAME not in names:
            raise self._refuse(f"exists and is not a bundle (it holds {foreign or names[0]})")
        if foreign:
            raise self._refuse(f"is not a bundle alone, it also holds {foreign}")

    def _probe(self) -> None:
        self._scratch.parent.mkdir(parents=True, exist_ok=True)
        remove_tree(self._scratch)
        self._scratch.mkdir()
        self._scratch.rmdir()

    def _prepare(self) -> None:
        _remove_abandoned(self._folder)
        (self._scratch / SOURCE).mkdir(parents=True)

    def _open(self, name: str) -> Any:
        return (self._scratch / name).open("wb")

    def _remove(self) -> None:
        remove_tree(self._scratch)


def _listed(folder: Path) -> Iterator[tuple[str, bool]]:
    return ((path.name, path.is_dir()) for path in sorted(folder.iterdir()))


def _remove_abandoned(folder: Path) -> None:
    """Delete what killed processes of this machine left of the same bundle."""
    for scratch in folder.parent.glob(f".{glob.escape(folder.name)}.partial-*"):
        pid = scratch.name.rpartition("-")[2]
        if not pid.isdecimal():
            continue
        try:
            os.kill(int(pid), 0)
        except ProcessLookupError:
            remove_tree(scratch)
        except (PermissionError, OverflowError):
            continue  # somebody else's process, or no process id


class _StorePlace(Place):
    """A store other than this machine's folders: files are written in place, and the manifest comes last.

    What a killed run left, which has codebooks but no manifest, counts as a bundle.
    """

    def __init__(self, url: str) -> None:
        super().__init__(url)
        self._fs, self._path = filesystem(url)
        self._written: list[str] = []
        self._made: list[str] = []
        with _writing(url):
            self._old_files()

    def finish(self) -> None:
        """The manifest, which came last, completes it."""

    def _prepare(self) -> None:
        """Delete the old bundle: it would be damaged by the first file, and more of its files than are written stay."""
        for name in self._old_files():
            with suppress(FileNotFoundError):
                self._fs.rm_file(f"{self._path}/{name}")
        folders = (self._path, f"{self._path}/{SOURCE}")
        self._made = [folder for folder in folders if not self._fs.exists(folder)]
        self._fs.makedirs(folders[-1], exist_ok=True)

    def _open(self, name: str) -> Any:
        self._written.append(name)
        return self._fs.open(f"{self._path}/{name}", "wb")

    def _remove(self) -> None:
        for name in self._written:
            try:
                self._fs.rm_file(f"{self._path}/{name}")
            except FileNotFoundError:
                continue
            except Exception as error:  # stores raise what they like, and the error that led here is the one to tell
                log.warning("%s/%s: is left of a bundle that was not completed (%s)", self._url, name, error)
        for folder in reversed(self._made):
            with suppress(OSError):  # somebody else's file is in it, or the store has no folders
                self._fs.rmdir(folder)

    def _old_files(self) -> list[str]:
        """Files of the old bundle: first the manifest, last the codebooks. Raises :class:`BundleError` for others."""
        self._fs.invalidate_cache()
        names = _names(self._listed(self._path), lambda: self._listed(f"{self._path}/{SOURCE}"))
        foreign = _foreign(names)
        if foreign or (names and not {MANIFEST_NAME, CODEBOOKS_NAME} & {*names}):
            raise self._refuse(f"exists and is not a bundle (it holds {foreign or names[0]})")
        return sorted(names, key=lambda name: (name != MANIFEST_NAME, name == CODEBOOKS_NAME))

    def _listed(self, path: str) -> Iterator[tuple[str, bool]]:
        try:
            entries = self._fs.ls(path, detail=True)
        except FileNotFoundError:
            return
        for entry in entries:
            name, is_folder = str(entry["name"]), entry["type"] == "directory"
            if name.rstrip("/") != path:
                yield name.rstrip("/").rpartition("/")[2], is_folder
            elif not is_folder and not name.endswith("/"):  # otherwise it is the mark that some stores keep of a folder
                raise self._refuse("exists and is not a bundle but a file")


def _names(top: Iterable[tuple[str, bool]], source: Callable[[], Iterable[tuple[str, bool]]]) -> list[str]:
    """Files at the top and in the folder :data:`SOURCE`, from names and whether each is a folder.

    Other folders, of which a bundle has none, end with a slash.
    """
    names = []
    for name, is_folder in top:
        if is_folder and name == SOURCE:
            names += [f"{SOURCE}/{inner}{'/' * deeper}" for inner, deeper in source()]
        else:
            names.append(name + "/" * is_folder)
    return names


def _foreign(names: Iterable[str]) -> str | None:
    """The first name that no file of a bundle has."""
    return next((name for name in names if not _NAME.fullmatch(name)), None)


@contextmanager
def _writing(what: str) -> Iterator[None]:
    """Whatever goes wrong in it becomes an error that names ``what``: stores of other makers raise what they like."""
    try:
        yield
    except CagsError:
        raise
    except OSError as error:
        raise OutputError.of(what, error) from error
    except Exception as error:
        way_out = "check the address and, for s3, the credentials in the environment"
        raise OutputError(f"{what}: cannot be written ({error}); {way_out}") from error
