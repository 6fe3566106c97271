"""Outputs of experiments: what cannot be written is refused at the start, before anything is measured."""

from __future__ import annotations

import os
from pathlib import Path

from cags_common.errors import ConfigError
from cags_common.files import writable_folder

PLOTS = (".png", ".svg", ".pdf")
"""Suffixes of plots."""


def check_suffix(name: str, given: str, suffixes: tuple[str, ...]) -> None:
    """Refuse a file, given by setting ``name``, of another kind than ``suffixes``. Raises :class:`ConfigError`."""
    if Path(given).suffix.lower() not in suffixes:
        *others, last = suffixes
        known = f"{', '.join(others)} or {last}" if others else last
        raise ConfigError(f"{name} = {given!r} must end in {known}")


def check_output_file(name: str, given: str, path: Path | None = None) -> None:
    """Refuse a file that cannot be written. ``path``: the file, if it is not the one ``given`` by setting ``name``.

    Raises :class:`ConfigError`, or :class:`OutputError` if nothing can be written in its folder.
    """
    path = Path(given) if path is None else path
    if path.is_dir() or not path.parent.is_dir():
        what = f"{path} is a folder" if path.is_dir() else f"there is no folder {path.parent}"
        raise ConfigError(f"{name} = {given!r}: {what}; name a file in an existing one")
    if path.is_file() or not path.exists():  # devices and pipes are written to as they are
        writable_folder(Path(os.path.realpath(path)).parent)
