"""What page and server say to each other.

The page sends JSON texts, parsed here into dataclasses and refused when anything is off. The server sends JSON texts
(``scene``, ``state``, ``shaper``, ``error``) and, for each shown frame, one binary message: the length of the header
(4 bytes, big-endian), the header in JSON, then the pictures and grids one after another, their sizes in the header.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from cags_client.output.page.pictures import PICTURES
from cags_common.errors import ProtocolError
from cags_common.geometry import Pose

MAX_TEXT_BYTES = 8192
MAX_NUMBER = 2**53
OVERLAYS = ("occlusion", "confidence", "detail", "tiles", "reference", "score")
MAX_PANES = 2
ACTIONS = ("play", "pause", "seek", "rate", "loop", "release")
NAMED = ("restorer", "exactness", "resolution")
"""Settings whose value is a name; that of the others is a number."""
NAMES = (*NAMED, "cap_mbps", "delay_ms")
_WORLD = 1e7


@dataclass(frozen=True, slots=True)
class PageHello:
    """The page is there. What it can show besides JPEG: ``h264`` by WebCodecs, ``raw`` pictures as they are."""

    h264: bool
    raw: bool = False


@dataclass(frozen=True, slots=True)
class PagePose:
    """The viewer's camera; ``number`` counts up."""

    number: int
    pose: Pose


@dataclass(frozen=True, slots=True)
class PageLook:
    """Which pictures and overlays the page wants from now on."""

    pictures: tuple[str, ...]
    overlays: frozenset[str]


@dataclass(frozen=True, slots=True)
class PageAction:
    """A turn of the transport bar: ``play``, ``pause``, ``seek`` to a frame, ``rate``, ``loop`` (0, 1), ``release``."""

    action: str
    value: float


@dataclass(frozen=True, slots=True)
class PageSetting:
    """A change of the panel: the name of a tier, or a number; None lifts a cap."""

    name: str
    value: str | float | None


@dataclass(frozen=True, slots=True)
class PageShown:
    """The page has drawn (or given up) message ``number``; ``key`` asks for pictures that need no earlier one."""

    number: int
    key: bool


PageMessage = PageHello | PagePose | PageLook | PageAction | PageSetting | PageShown


def parse(text: str) -> PageMessage:
    """Parse a text of the page. Raises :class:`ProtocolError` that names the field."""
    if len(text) > MAX_TEXT_BYTES:
        raise ProtocolError(f"page message of {len(text)} characters is longer than {MAX_TEXT_BYTES}")
    try:
        fields = json.loads(text)
    except (ValueError, RecursionError) as error:  # not JSON, a number of too many digits, or lists in lists in lists
        raise ProtocolError(f"page message is not JSON ({error})") from error
    kind = fields.get("type") if isinstance(fields, dict) else None
    parser = _PARSERS.get(kind) if isinstance(kind, str) else None
    if parser is None:
        raise ProtocolError(f"page message of unknown type {kind!r}; known: {', '.join(_PARSERS)}")
    return parser(fields)


def _hello(fields: dict[str, Any]) -> PageHello:
    return PageHello(_flag(fields, "h264"), "raw" in fields and _flag(fields, "raw"))


def _pose(fields: dict[str, Any]) -> PagePose:
    p, q = _numbers(fields, "position", 3), _numbers(fields, "rotation", 4)
    try:
        return PagePose(_whole(fields, "number"), Pose((p[0], p[1], p[2]), (q[0], q[1], q[2], q[3])))
    except ValueError as error:
        raise ProtocolError(f"page pose: {error}") from error


def _look(fields: dict[str, Any]) -> PageLook:
    pictures = _names(fields, "pictures", PICTURES, MAX_PANES)
    if not pictures:
        raise ProtocolError("page message: pictures is empty; ask for one at least")
    return PageLook(pictures, frozenset(_names(fields, "overlays", OVERLAYS, len(OVERLAYS))))


def _action(fields: dict[str, Any]) -> PageAction:
    action = _choice(fields, "action", ACTIONS)
    return PageAction(action, _number(fields, "value") if "value" in fields else 0.0)


def _setting(fields: dict[str, Any]) -> PageSetting:
    name = _choice(fields, "name", NAMES)
    value = fields.get("value")
    if name in NAMED:
        if not isinstance(value, str):
            raise ProtocolError(f"page message: {name} = {value!r} must be a name")
        return PageSetting(name, value)
    return PageSetting(name, None if value is None else _number(fields, "value"))


def _shown(fields: dict[str, Any]) -> PageShown:
    return PageShown(_whole(fields, "number"), _flag(fields, "key"))


_PARSERS: dict[str, Callable[[dict[str, Any]], PageMessage]] = {
    "hello": _hello,
    "pose": _pose,
    "look": _look,
    "action": _action,
    "setting": _setting,
    "shown": _shown,
}


def _flag(fields: dict[str, Any], name: str) -> bool:
    value = fields.get(name)
    if not isinstance(value, bool):
        raise ProtocolError(f"page message: {name} = {value!r} must be true or false")
    return value


def _number(fields: dict[str, Any], name: str) -> float:
    return _real(name, fields.get(name))


def _real(name: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= MAX_NUMBER:
        raise ProtocolError(f"page message: {name} = {value!r} must be a finite number")
    return float(value)


def _whole(fields: dict[str, Any], name: str) -> int:
    value = _number(fields, name)
    if value < 0 or value != math.floor(value):
        raise ProtocolError(f"page message: {name} = {value!r} must be a whole number from 0")
    return int(value)


def _numbers(fields: dict[str, Any], name: str, count: int) -> list[float]:
    values = fields.get(name)
    if not isinstance(values, list) or len(values) != count:
        raise ProtocolError(f"page message: {name} = {values!r} must be a list of {count} numbers")
    numbers = [_real(name, value) for value in values]
    if any(abs(value) > _WORLD for value in numbers):
        raise ProtocolError(f"page message: {name} = {values!r} lies outside the world")
    return numbers


def _choice(fields: dict[str, Any], name: str, choices: Sequence[str]) -> str:
    value = fields.get(name)
    if not isinstance(value, str) or value not in choices:
        raise ProtocolError(f"page message: {name} = {value!r} must be one of {', '.join(choices)}")
    return value


def _names(fields: dict[str, Any], name: str, choices: Sequence[str], at_most: int) -> tuple[str, ...]:
    values = fields.get(name)
    if not isinstance(values, list) or len(values) > at_most:
        raise ProtocolError(f"page message: {name} = {values!r} must be a list of at most {at_most} names")
    return tuple(dict.fromkeys(_choice({name: value}, name, choices) for value in values))


def pack(header: dict[str, Any], payloads: Sequence[bytes]) -> bytes:
    """The binary message of one shown frame. Numbers that are not finite become null."""
    text = json.dumps(_finite(header), separators=(",", ":"), allow_nan=False).encode()
    return b"".join([struct.pack(">I", len(text)), text, *payloads])


def _finite(value: Any) -> Any:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return value
