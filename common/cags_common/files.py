"""Files that are there whole or not at all: written under another name beside their own, then moved."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from cags_common.errors import OutputError


class WholeFile:
    """A file in the making. Write to :attr:`writing`, then :meth:`keep` or :meth:`drop` it.

    A link stays a link: what it points at is replaced. A device or a pipe must not be replaced by a file, so it is
    written to directly.
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
        """Leave nothing behind, unless it was kept."""
        if self._target is not None:
            self.writing.unlink(missing_ok=True)


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Where to write what shall appear at ``path``; it does at the end of the block, unless an error ends it.

    Raises :class:`OutputError` for a place that cannot be written.
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
    """Write ``data``. Raises :class:`OutputError` for a place that cannot be written."""
    with whole_file(path) as writing:
        writing.write_bytes(data)


def writable_folder(path: Path) -> Path:
    """The folder, made where it is not there. Raises :class:`OutputError` unless files can be written in it."""
    probe = path / ".cags-probe"
    try:
        path.mkdir(parents=True, exist_ok=True)
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise OutputError.of(path, error) from error
    return path


def _takes_bytes_as_they_come(path: Path) -> bool:
    return path.exists() and not path.is_file() and not path.is_dir()
