"""Checked access to the fields of a SOG ``meta.json``."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from cags_common.errors import SceneError
from cags_common.geometry import F32


class SogMeta:
    """A parsed ``meta.json``. Fields are addressed by dotted paths, which also name them in errors."""

    def __init__(self, table: object, source: str) -> None:
        self._table, self._source = table, source
        if not isinstance(table, dict):
            raise self._error("the top level", "an object")

    def has(self, path: str) -> bool:
        """Whether a field exists and is not null."""
        return self._get(path) is not None

    def integer(self, path: str, low: int, high: int) -> int:
        """A whole number in ``[low, high]``."""
        value = self._get(path)
        if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
            raise self._error(path, f"a whole number in {low}..{high}")
        return value

    def number(self, path: str) -> float:
        """A finite number."""
        value = self._get(path)
        if not _is_number(value):
            raise self._error(path, "a finite number")
        return float(value)

    def numbers(self, path: str, count: int) -> F32:
        """A list of exactly ``count`` finite numbers, as float32 [count]."""
        value = self._get(path)
        if not isinstance(value, list) or len(value) != count or not all(map(_is_number, value)):
            raise self._error(path, f"a list of {count} finite numbers")
        return np.array(value, np.float64).astype(np.float32)

    def file(self, attribute: str, index: int, count: int) -> str:
        """Name of file ``index`` of the ``count`` files that hold an attribute: a plain name, never a path."""
        value = self._get(f"{attribute}.files")
        if not isinstance(value, list) or len(value) != count or not all(map(_is_plain_name, value)):
            raise self._error(f"{attribute}.files", f"a list of {count} plain file names")
        name: str = value[index]
        return name

    def _get(self, path: str) -> Any:
        value: Any = self._table
        for key in path.split("."):
            value = value.get(key) if isinstance(value, dict) else None
        return value

    def _error(self, path: str, expected: str) -> SceneError:
        return SceneError(f"{self._source}: meta.json: {path} must be {expected}; repair the file")


def _is_number(value: object) -> bool:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return abs(value) <= float(np.finfo(np.float32).max) and math.isfinite(value)


def _is_plain_name(value: object) -> bool:
    return (
        isinstance(value, str) and 0 < len(value) <= 255 and value not in (".", "..") and not set(value) & set("/\\\0:")
    )
