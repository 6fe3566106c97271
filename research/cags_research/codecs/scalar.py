"""Scalar quantisation for codecs without codebooks: 8 bits per number, between a clip's smallest and largest value."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cags_common.errors import DecodeError
from cags_common.geometry import F32
from cags_common.tiles.attributes import ATTRIBUTE_DIMS

U8 = NDArray[np.uint8]
STEPS = 255
MAX_BOOK_BYTES = 1 << 16

ATTRIBUTES = ("scale", "rotation", "alpha", "sh0", "sh1", "sh2", "sh3")
"""Coded attributes in order; SH bands up to the scene's degree."""


@dataclass(frozen=True, eq=False)
class ScalarBook:
    """Ranges of all numbers of all attributes, which is everything that a decoder needs."""

    ranges: Mapping[str, tuple[F32, F32]]  # attribute -> smallest [dim], largest [dim]

    @classmethod
    def over(cls, values: Mapping[str, F32]) -> ScalarBook:
        """Ranges of the coded attributes in ``values`` (attribute -> [n, dim], n >= 1)."""
        return cls(
            {name: (values[name].min(axis=0), values[name].max(axis=0)) for name in ATTRIBUTES if name in values}
        )

    def __iter__(self) -> Iterator[str]:
        return iter(self.ranges)

    @property
    def dims(self) -> tuple[int, ...]:
        """Numbers per splat of each attribute, in coding order."""
        return tuple(len(low) for low, _ in self.ranges.values())

    def quantise(self, name: str, values: F32) -> U8:
        """Quantise ``values`` [n, dim] to bytes [n, dim]; values outside the range are clamped."""
        low, high = (end.astype(np.float64) for end in self.ranges[name])
        share = (values - low) / np.where(high > low, high - low, 1.0)
        return np.rint(np.clip(share, 0.0, 1.0) * STEPS).astype(np.uint8)

    def dequantise(self, name: str, codes: NDArray[np.integer]) -> F32:
        """Inverse of :meth:`quantise`, with an error of half a step at most."""
        low, high = (end.astype(np.float64) for end in self.ranges[name])
        values: F32 = (low + codes / STEPS * (high - low)).astype(np.float32)
        return values

    def to_bytes(self) -> bytes:
        """JSON; equal books give equal bytes."""
        table = [[name, low.tolist(), high.tolist()] for name, (low, high) in self.ranges.items()]
        return json.dumps(table, separators=(",", ":")).encode()

    @classmethod
    def from_bytes(cls, data: bytes | memoryview) -> ScalarBook:
        """Inverse of :meth:`to_bytes`. Raises :class:`DecodeError`."""
        if len(data) > MAX_BOOK_BYTES:
            raise DecodeError(f"attribute ranges: {len(data)} bytes are more than the allowed {MAX_BOOK_BYTES}")
        try:
            table = json.loads(bytes(data))
        except (ValueError, RecursionError) as error:
            raise DecodeError(f"attribute ranges: are not JSON ({error})") from error
        rows = table if isinstance(table, list) else []
        ranges = {row[0]: (_vector(row[1]), _vector(row[2])) for row in rows if _is_row(row)}
        if len(ranges) != len(rows) or tuple(ranges) not in (ATTRIBUTES[:4], *(ATTRIBUTES[:k] for k in (5, 6, 7))):
            raise DecodeError(
                "attribute ranges: must name each attribute once, in order, with its smallest and largest"
            )
        return cls(ranges)


def _is_row(row: object) -> bool:
    if not isinstance(row, list) or len(row) != 3 or row[0] not in ATTRIBUTES:
        return False
    ends = [
        isinstance(end, list) and len(end) == ATTRIBUTE_DIMS[row[0]] and all(map(_is_number, end)) for end in row[1:]
    ]
    return all(ends)


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and math.isfinite(value) and abs(value) < 1e30


def _vector(values: list[float]) -> F32:
    return np.array(values, np.float32)
