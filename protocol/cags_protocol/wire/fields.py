"""Kinds of header fields: how a value is checked, written as MessagePack, and read back from an untrusted peer.

``pack`` and ``unpack`` both check, so that nothing invalid is sent and nothing invalid is accepted. Both raise
:class:`ProtocolError` with the field's name and the offending value (shortened).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, NoReturn, Protocol

from cags_common.errors import ProtocolError
from cags_common.geometry import Intrinsics, Pose


class Kind(Protocol):
    """How one field travels."""

    def pack(self, value: Any, name: str) -> Any:
        """The MessagePack-able form of ``value``; ``name`` is for errors."""

    def unpack(self, raw: Any, name: str) -> Any:
        """The typed value of what a peer sent."""


def wire(kind: Kind, default: Any = ...) -> Any:
    """A dataclass field that travels in the header; with a ``default`` it is optional and left out when equal to it."""
    metadata = {"kind": kind}
    return field(metadata=metadata) if default is ... else field(default=default, metadata=metadata)


def refuse(name: str, value: Any, expected: str) -> NoReturn:
    """Raise the one-line error for a field that does not hold what it must."""
    shown = repr(value)
    shown = shown if len(shown) <= 60 else shown[:57] + "..."
    raise ProtocolError(f"{name} = {shown} must be {expected}")


@dataclass(frozen=True, slots=True)
class Symmetric:
    """A kind whose wire form is the value itself: one check serves both directions."""

    def check(self, value: Any, name: str) -> Any:
        """``value``, or :class:`ProtocolError`."""
        raise NotImplementedError

    def pack(self, value: Any, name: str) -> Any:
        """See :class:`Kind`."""
        return self.check(value, name)

    def unpack(self, raw: Any, name: str) -> Any:
        """See :class:`Kind`."""
        return self.check(raw, name)


@dataclass(frozen=True, slots=True)
class Integer(Symmetric):
    """An integer in [low, high]; booleans are refused."""

    high: int
    low: int = 0

    def check(self, value: Any, name: str) -> int:
        """See :class:`Symmetric`."""
        if type(value) is not int or not self.low <= value <= self.high:
            refuse(name, value, f"an integer in [{self.low}, {self.high}]")
        return value


@dataclass(frozen=True, slots=True)
class Real(Symmetric):
    """A finite number in [low, high], as float."""

    low: float
    high: float

    def check(self, value: Any, name: str) -> float:
        """See :class:`Symmetric`."""
        if type(value) not in (float, int) or not self.low <= value <= self.high:  # NaN fails both comparisons
            refuse(name, value, f"a number in [{self.low:g}, {self.high:g}]")
        return float(value)


@dataclass(frozen=True, slots=True)
class Flag(Symmetric):
    """A boolean."""

    def check(self, value: Any, name: str) -> bool:
        """See :class:`Symmetric`."""
        if type(value) is not bool:
            refuse(name, value, "true or false")
        return value


@dataclass(frozen=True, slots=True)
class Text(Symmetric):
    """Printable text of at most ``max_bytes`` in UTF-8; control characters would let a peer forge log lines."""

    max_bytes: int

    def check(self, value: Any, name: str) -> str:
        """See :class:`Symmetric`."""
        if type(value) is not str or (not value.isprintable()) or len(value.encode()) > self.max_bytes:
            refuse(name, value, f"printable text of at most {self.max_bytes} bytes")
        return value


@dataclass(frozen=True, slots=True)
class Choice(Symmetric):
    """One of a few words."""

    words: tuple[str, ...]

    def check(self, value: Any, name: str) -> str:
        """See :class:`Symmetric`."""
        if type(value) is not str or value not in self.words:
            refuse(name, value, f"one of {', '.join(self.words)}")
        return value


@dataclass(frozen=True, slots=True)
class ListOf:
    """At most ``max_items`` values of one kind; a tuple in Python."""

    kind: Kind
    max_items: int

    def pack(self, value: Any, name: str) -> list[Any]:
        """See :class:`Kind`."""
        if not isinstance(value, tuple) or len(value) > self.max_items:
            refuse(name, value, f"a tuple of at most {self.max_items}")
        return [self.kind.pack(item, name) for item in value]

    def unpack(self, raw: Any, name: str) -> tuple[Any, ...]:
        """See :class:`Kind`."""
        if type(raw) is not list or len(raw) > self.max_items:
            refuse(name, raw, f"a list of at most {self.max_items}")
        found = self.kind.integers(raw) if type(self.kind) is Record else None
        return tuple([self.kind.unpack(item, name) for item in raw] if found is None else found)


@dataclass(frozen=True, slots=True)
class Record:
    """A frozen dataclass written as the list of its fields, in order; each field has its kind in ``kinds``."""

    cls: type[Any]
    names: tuple[str, ...]
    kinds: tuple[Kind, ...]

    def pack(self, value: Any, name: str) -> list[Any]:
        """See :class:`Kind`."""
        if type(value) is not self.cls:
            refuse(name, value, f"a {self.cls.__name__}")
        return [k.pack(getattr(value, n), f"{name}.{n}") for n, k in zip(self.names, self.kinds, strict=True)]

    def unpack(self, raw: Any, name: str) -> Any:
        """See :class:`Kind`. Later versions may append to a record: what lies beyond the known fields is ignored."""
        if type(raw) is not list or len(raw) < len(self.kinds):
            refuse(name, raw, f"a list of at least {len(self.kinds)}")
        values = [k.unpack(v, f"{name}.{n}") for n, k, v in zip(self.names, self.kinds, raw, strict=False)]
        try:
            return self.cls(*values)
        except ValueError as error:
            raise ProtocolError(f"{name}: {error}") from error

    def integers(self, raws: list[Any]) -> list[Any] | None:
        """The values of ``raws``, at once; None where a field is no integer, or one of them is not as it must be.

        A peer may send hundreds in one message: :meth:`unpack` takes ten times as long, and says what is wrong.
        """
        if not self._all_integers:
            return None
        count, cls, bounds = len(self.kinds), self.cls, [(kind.low, kind.high) for kind in self.kinds]  # type: ignore[attr-defined]
        rows = [raw[:count] for raw in raws if type(raw) is list]
        columns = list(zip(*rows, strict=False))
        if len(rows) != len(raws) or not raws or any(len(row) != count for row in rows):
            return None
        for column, (low, high) in zip(columns, bounds, strict=True):
            if set(map(type, column)) != {int} or min(column) < low or max(column) > high:
                return None
        try:
            return list(map(cls, *columns))
        except ValueError:
            return None

    @property
    def _all_integers(self) -> bool:
        return all(type(kind) is Integer for kind in self.kinds)


_FINITE = Real(-1e9, 1e9)
_UNIT = Real(-1.001, 1.001)


@dataclass(frozen=True, slots=True)
class PoseKind:
    """A :class:`Pose` as seven numbers: position (metres, world), quaternion ``wxyz`` of unit length (to 1e-3)."""

    def pack(self, value: Any, name: str) -> list[float]:
        """See :class:`Kind`."""
        if type(value) is not Pose:
            refuse(name, value, "a Pose")
        return [_FINITE.check(c, name) for c in value.position] + list(value.rotation)

    def unpack(self, raw: Any, name: str) -> Pose:
        """See :class:`Kind`."""
        if type(raw) is not list or len(raw) != 7:
            refuse(name, raw, "seven numbers")
        x, y, z = (_FINITE.check(c, name) for c in raw[:3])
        w, i, j, k = (_UNIT.check(c, name) for c in raw[3:])
        if abs(math.sqrt(w * w + i * i + j * j + k * k) - 1.0) > 1e-3:
            refuse(name, raw, "a position and a unit quaternion")
        return Pose((x, y, z), (w, i, j, k))


_SIDE = Integer(low=1, high=16384)
_FOCAL = Real(1e-3, 1e6)
_CENTRE = Real(-1e6, 1e6)

INTRINSICS = Record(
    Intrinsics,
    ("width_px", "height_px", "fx_px", "fy_px", "cx_px", "cy_px"),
    (_SIDE, _SIDE, _FOCAL, _FOCAL, _CENTRE, _CENTRE),
)
POSE = PoseKind()
