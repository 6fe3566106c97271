"""Implementations by name: the program's own, and those that installed packages register as entry points.

A registry is a dict of the program's own. What exists to be compared with (:mod:`cags_research`) stands in an entry
point group instead: it is found by name when it is asked for, and nothing of it is imported before.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib.metadata import EntryPoint, entry_points
from typing import TypeVar, cast

from cags_common.errors import ConfigError

T = TypeVar("T")


class Registry(dict[str, T]):
    """The program's own implementations by name, and the way to the others."""

    def __init__(self, what: str, group: str, own: Mapping[str, T], *, extra: str = "research") -> None:
        """``what`` names the kind in errors (``aligner``, ``abr =``); ``group`` is that of the entry points.

        ``extra`` of the distribution brings the packages that registered implementations need.
        """
        super().__init__(own)
        self.what, self.group, self.extra = what, group, extra

    def names(self) -> tuple[str, ...]:
        """Every name: the program's own in their order, then the registered ones, sorted."""
        return (*self, *sorted({entry.name for entry in entry_points(group=self.group)} - self.keys()))

    def find(self, name: str, *, also: tuple[str, ...] = ()) -> T:
        """The implementation called ``name``; ``also`` are names that errors list before those here.

        Raises :class:`ConfigError` for an unknown one, and for one that needs a package which is not installed.
        """
        if name in self:
            return self[name]
        found = tuple(entry_points(group=self.group, name=name)) if name else ()
        if not found:
            raise ConfigError(f"{self.what} {name!r} is unknown; known: {', '.join((*also, *self.names()))}")
        return cast("T", self._loaded(found[0]))

    def _loaded(self, entry: EntryPoint) -> object:
        try:
            return entry.load()
        except ImportError as error:
            lacking = f"the package {error.name}" if error.name else f"what is not installed ({error})"
            way_out = f"pip install 'cags-stream[{self.extra}]'"
            raise ConfigError(f"{self.what} {entry.name!r} needs {lacking}: {way_out}") from error
