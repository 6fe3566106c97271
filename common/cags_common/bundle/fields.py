"""Typed access to parsed JSON that strangers may have written: one line names the field and what it must be."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, TypeVar

from cags_common.errors import BundleError
from cags_common.geometry import Vec3

T = TypeVar("T")


class Fields:
    """One parsed JSON value; errors name ``source`` and the path of the field."""

    def __init__(self, value: Any, path: str = "", source: str = "manifest") -> None:
        self._value, self._path, self._source = value, path, source

    def _get(self, name: str) -> tuple[Any, str]:
        if not name:
            return self._value, self._path
        path = f"{self._path}.{name}" if self._path else name
        if not isinstance(self._value, dict) or name not in self._value:
            raise BundleError(f"{self._source}: {path} is missing")
        return self._value[name], path

    def has(self, name: str) -> bool:
        """Whether an optional field is there; null means that it is not."""
        return isinstance(self._value, dict) and self._value.get(name) is not None

    def names(self) -> set[str]:
        """Names of an object's fields. Raises :class:`BundleError` for another value."""
        if not isinstance(self._value, dict):
            raise BundleError(f"{self._source}: {self._path or 'the whole'} must be an object with named fields")
        return set(self._value)

    def fault(self, name: str, wanted: str) -> BundleError:
        """What to raise where a field is not what is ``wanted``."""
        value, path = self._get(name)
        return BundleError(f"{self._source}: {path} = {repr(value)[:40]} must be {wanted}")

    def inner(self, name: str) -> Fields:
        """A field that holds fields or values of its own."""
        return Fields(*self._get(name), self._source)

    def text(self, name: str) -> str:
        """A text of at most 1,024 characters."""
        value, path = self._get(name)
        if not isinstance(value, str) or len(value) > 1024:
            raise BundleError(f"{self._source}: {path} must be a short text")
        return value

    def integer(self, name: str, low: int, high: int) -> int:
        """A whole number within bounds."""
        value, path = self._get(name)
        if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
            raise BundleError(f"{self._source}: {path} = {repr(value)[:40]} must be a whole number in [{low}, {high}]")
        return value

    def number(self, name: str, low: float, high: float) -> float:
        """A number within bounds."""
        value, path = self._get(name)
        if not isinstance(value, int | float) or isinstance(value, bool) or not low <= value <= high:
            raise BundleError(f"{self._source}: {path} = {repr(value)[:40]} must be a number in [{low}, {high}]")
        return float(value)

    def vector(self, name: str) -> Vec3:
        """Three finite numbers."""
        value, path = self._get(name)
        parts = self.many(name, lambda f: f.number("", -1e30, 1e30), 3)
        if len(parts) != 3 or not all(map(math.isfinite, parts)):
            raise BundleError(f"{self._source}: {path} must be three numbers, not {repr(value)[:40]}")
        return parts[0], parts[1], parts[2]

    def sequence(self, name: str) -> list[Any]:
        """A list, as it is."""
        value, path = self._get(name)
        if not isinstance(value, list):
            raise BundleError(f"{self._source}: {path} must be a list")
        return value

    def many(self, name: str, read: Callable[[Fields], T], most: int) -> tuple[T, ...]:
        """A list of at most ``most`` entries, each read by ``read``."""
        values, (_, path) = self.sequence(name), self._get(name)
        if len(values) > most:
            raise BundleError(f"{self._source}: {path} has {len(values)} entries; at most {most} are allowed")
        return tuple(read(Fields(value, f"{path}[{i}]", self._source)) for i, value in enumerate(values))
