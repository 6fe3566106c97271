"""What page and server say to each other.

The page sends JSON texts, parsed here into dataclasses and refused when anything is off. The server sends JSON texts
(``scene``: what there is and what may be chosen; ``state``; ``error``) and, for each shown frame, one binary message:
the length of the header (4 bytes, big-endian), the header in JSON, then the pictures and grids one after another, their
sizes in the header. ``tests/vectors/page`` has one of each, which both sides are held to; the page's side is
``web/src/client/messages.ts``.
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
FLAGS = ("playing", "loop", "held")
"""On or off; ``held`` off follows the recorded walk again."""
NUMBERS = ("frame", "rate", "cap_mbps", "delay_ms")
"""Numbers: ``frame`` seeks; ``cap_mbps`` None lifts the cap."""
NAMED = ("restorer", "exactness", "resolution")
"""Chosen by name."""
MAX_TOKEN = 256
MAX_WINDOW_PX = 32768
_WORLD = 1e7


@dataclass(frozen=True, slots=True)
class PageHello:
    """The page is there. What it can show besides JPEG: ``h264`` by WebCodecs, ``raw`` pictures as they are."""

    h264: bool
    raw: bool = False
    token: str = ""
    """Of a client that asks for one."""


@dataclass(frozen=True, slots=True)
class PagePose:
    """Where the viewer's camera was at ``at_us``, whole microseconds of the page's own clock."""

    at_us: int
    pose: Pose


@dataclass(frozen=True, slots=True)
class PageWindow:
    """The page shows pictures on so many pixels of its screen."""

    width: int
    height: int


@dataclass(frozen=True, slots=True)
class PageLook:
    """Which pictures and overlays the page wants from now on."""

    pictures: tuple[str, ...]
    overlays: frozenset[str]


@dataclass(frozen=True, slots=True)
class PageSet:
    """Something is to be otherwise: one of :data:`FLAGS`, :data:`NUMBERS` or :data:`NAMED`."""

    name: str
    value: bool | float | str | None


@dataclass(frozen=True, slots=True)
class PageShown:
    """The page has drawn (or given up) message ``number``; ``key`` asks for pictures that need no earlier one."""

    number: int
    key: bool


PageMessage = PageHello | PagePose | PageWindow | PageLook | PageSet | PageShown


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
    token = fields.get("token", "")
    if not isinstance(token, str) or len(token) > MAX_TOKEN:
        raise ProtocolError(f"page message: token must be a text of at most {MAX_TOKEN} characters")
    try:
        token.encode()
    except UnicodeEncodeError as error:  # JSON may hold half of a pair of surrogates
        raise ProtocolError(f"page message: token must be a text of whole characters ({error.reason})") from error
    return PageHello(_flag(fields, "h264"), "raw" in fields and _flag(fields, "raw"), token)


def _pose(fields: dict[str, Any]) -> PagePose:
    p, q = _numbers(fields, "position", 3), _numbers(fields, "rotation", 4)
    try:
        return PagePose(_whole(fields, "at_us"), Pose((p[0], p[1], p[2]), (q[0], q[1], q[2], q[3])))
    except ValueError as error:
        raise ProtocolError(f"page pose: {error}") from error


def _window(fields: dict[str, Any]) -> PageWindow:
    width, height = _whole(fields, "width"), _whole(fields, "height")
    if not (0 < width <= MAX_WINDOW_PX and 0 < height <= MAX_WINDOW_PX):
        raise ProtocolError(f"page message: a window of {width} x {height} pixels; 1 to {MAX_WINDOW_PX} a side are")
    return PageWindow(width, height)


def _look(fields: dict[str, Any]) -> PageLook:
    pictures = _names(fields, "pictures", PICTURES, MAX_PANES)
    if not pictures:
        raise ProtocolError("page message: pictures is empty; ask for one at least")
    return PageLook(pictures, frozenset(_names(fields, "overlays", OVERLAYS, len(OVERLAYS))))


def _set(fields: dict[str, Any]) -> PageSet:
    name = _choice(fields, "name", (*FLAGS, *NUMBERS, *NAMED))
    value = fields.get("value")
    if name in FLAGS:
        return PageSet(name, _flag({name: value}, name))
    if name in NAMED:
        if not isinstance(value, str):
            raise ProtocolError(f"page message: {name} = {value!r} must be a name")
        return PageSet(name, value)
    return PageSet(name, None if value is None and name == "cap_mbps" else _real(name, value))


def _shown(fields: dict[str, Any]) -> PageShown:
    return PageShown(_whole(fields, "number"), _flag(fields, "key"))


_PARSERS: dict[str, Callable[[dict[str, Any]], PageMessage]] = {
    "hello": _hello,
    "pose": _pose,
    "window": _window,
    "look": _look,
    "set": _set,
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
