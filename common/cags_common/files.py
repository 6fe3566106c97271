"""Atomic files: each is written under a temporary name beside its own and then moved into place."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from cags_common.errors import OutputError


class WholeFile:
    """An unfinished file. Write to :attr:`writing`, then call :meth:`keep` or :meth:`drop`.

    A symbolic link stays a link, and its target is replaced. Devices and pipes are written to directly, because a file
    must not replace them.
    """

    def __init__(self, path: Path) -> None:
        self._target: Path | None = None
        self.writing = path
        if not _takes_bytes_as_they_come(path):
            self._target = path.resolve() if path.is_symlink() else path
            self.writing = self._target.with_name(f".{self._target.name}.{os.getpid()}.part")

    def keep(self) -> None:
        """The file is complete: move it into place."""
        if self._target is not None:
            self.writing.replace(self._target)

    def drop(self) -> None:
        """Remove the temporary file, unless it was kept."""
        if self._target is not None:
            self.writing.unlink(missing_ok=True)


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """A temporary path to write to, which is moved to ``path`` at the end of the block unless an error ends it.

    Raises :class:`OutputError` if ``path`` cannot be written.
    """
    file = WholeFile(path)
    try:
        yield file.writing
        file.keep()
    except OSError as error:
        raise OutputError.of(path, error) from error
    finally:
        file.drop()


def write_whole(path: Path, data: bytes) -> None:
    """Write ``data`` to a file. Raises :class:`OutputError` if it cannot be written."""
    with whole_file(path) as writing:
        writing.write_bytes(data)


def writable_folder(path: Path) -> Path:
    """Create the folder if necessary and return it. Raises :class:`OutputError` if files cannot be written in it."""
    if path.exists() and not path.is_dir():
        raise OutputError(f"{path}: cannot be written (it is no folder); choose another place")
    try:
        path.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path, prefix=".cags-probe"):
            pass
    except OSError as error:
        raise OutputError.of(path, error) from error
    return path


def _takes_bytes_as_they_come(path: Path) -> bool:
    return path.exists() and not path.is_file() and not path.is_dir()
