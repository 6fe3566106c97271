"""The strict encoding of messages: bytes to checked dataclasses and back.

Lengths are bounded before anything of that size is allocated, values are checked in both directions, and the header's
last entry is the CRC-32 of everything else; see ``docs/wire.md``. Headers are read in either form, with text keys or
with numbers; which one is written depends on the message.
"""

from __future__ import annotations

import dataclasses
import zlib
from dataclasses import dataclass
from typing import Any

import msgpack

from cags_common.errors import ProtocolError
from cags_protocol.wire import limits
from cags_protocol.wire.fields import Kind
from cags_protocol.wire.messages import (
    CLIENT_MESSAGES,
    NO_PAYLOAD,
    OPAQUE,
    SERVER_MESSAGES,
    Blob,
    Buffer,
    Fragment,
    Hello,
    Message,
    TileLayers,
)


@dataclass(frozen=True, slots=True)
class _Spec:
    cls: type[Message]
    fields: tuple[tuple[str, Kind, Any], ...]  # name, kind, default or MISSING


def _spec(cls: Any) -> _Spec:
    headers = [f for f in dataclasses.fields(cls) if "kind" in f.metadata]
    return _Spec(cls, tuple((f.name, f.metadata["kind"], f.default) for f in headers))


_SPECS = {cls: _spec(cls) for cls in {*CLIENT_MESSAGES, *SERVER_MESSAGES}}
_BY_TAG = {cls.TAG: spec for cls, spec in _SPECS.items()}
_BY_CODE = {cls.CODE: spec for cls, spec in _SPECS.items() if cls.CODE is not None}
_TYPE, _CRC = 0, 127
"""Keys of the type and of the CRC in headers with numbers."""
_TEXT_MARK, _NUMBER_MARK = b"\xa3crc\xce", b"\x7f\xce"
"""What stands before the CRC: its key, and the head of a uint32."""

Header = dict[str | int, Any]


class DamagedError(ProtocolError):
    """The CRC of a message is missing or wrong: the message was damaged, or is none."""


class VersionError(ProtocolError):
    """A Hello of a protocol version that this package does not support."""

    def __init__(self, theirs: int) -> None:
        ours = ", ".join(map(str, limits.SUPPORTED_VERSIONS))
        super().__init__(
            f"version = {theirs} is not spoken here; this server speaks {ours}; use a client of that version"
        )
        self.theirs = theirs


def encode(message: Message, payload: Buffer = b"") -> bytes:
    """Encode ``message`` with its payload. Raises :class:`ProtocolError` for invalid values."""
    return b"".join(encode_parts(message, payload))


def encode_parts(message: Message, payload: Buffer = b"") -> tuple[bytes, Buffer]:
    """Encode ``message`` as header and payload; the payload is not copied. Raises :class:`ProtocolError`."""
    spec = _SPECS[type(message)]
    kind = spec.cls.PAYLOAD
    if kind == OPAQUE:
        _check_payload(message, len(payload))
    elif len(payload):
        raise ProtocolError(f"{spec.cls.TAG} carries no separate payload")
    elif kind != NO_PAYLOAD:
        payload = getattr(message, kind)
    code = spec.cls.CODE
    header: Header = {"type": spec.cls.TAG} if code is None else {_TYPE: code}
    for number, (name, field_kind, default) in enumerate(spec.fields, start=1):
        value = getattr(message, name)
        if default is dataclasses.MISSING or value != default:
            header[name if code is None else number] = field_kind.pack(value, name)
    # The widest integer form; the value is written below, over these four bytes.
    header["crc" if code is None else _CRC] = 0xFFFFFFFF
    head = msgpack.packb(header)[:-4]
    if len(head) + 4 > limits.MAX_HEADER_BYTES:
        raise ProtocolError(f"{spec.cls.TAG}: header of {len(head) + 4} bytes, at most {limits.MAX_HEADER_BYTES}")
    crc = zlib.crc32(payload, zlib.crc32(head))
    return head + crc.to_bytes(4, "big"), payload


def decode(data: Buffer) -> tuple[Message, memoryview]:
    """Decode one wire message into message and payload (a view into ``data``). Raises :class:`ProtocolError` only.

    A :class:`Hello` of another version raises :class:`VersionError`, whatever its other fields are.
    """
    view = memoryview(data)
    header, end = _header(view)
    payload = view[end:]
    mark = _NUMBER_MARK if _TYPE in header else _TEXT_MARK
    if bytes(view[max(end - 4 - len(mark), 0) : end - 4]) != mark:
        raise DamagedError("header does not end with its crc")
    if zlib.crc32(payload, zlib.crc32(view[: end - 4])) != int.from_bytes(view[end - 4 : end], "big"):
        raise DamagedError("crc does not match: the message was damaged on its way")
    spec = _spec_of(header)
    if spec.cls is Hello:
        _check_version(header)
    message = _build(spec, header, payload)
    if spec.cls.PAYLOAD == OPAQUE:
        _check_payload(message, len(payload))
        return message, payload
    return message, payload[:0]


def _spec_of(header: Header) -> _Spec:
    if _TYPE in header:
        found = header[_TYPE]
        spec = _BY_CODE.get(found) if type(found) is int else None
    else:
        found = header.get("type")
        spec = _BY_TAG.get(found) if type(found) is str else None
    if spec is None:
        raise ProtocolError(f"type = {found!r:.60} is not a known message")
    return spec


def printable(text: str) -> str:
    """``text`` made valid for a text field: control characters replaced, truncated."""
    clean = "".join(c if c.isprintable() else "?" for c in text)
    return clean.encode()[: limits.MAX_TEXT_BYTES].decode(errors="ignore")


def _header(view: memoryview) -> tuple[Header, int]:
    unpacker = msgpack.Unpacker(
        object_pairs_hook=_map,
        strict_map_key=False,  # `_map` is stricter
        max_buffer_size=limits.MAX_HEADER_BYTES,
        max_str_len=limits.MAX_TEXT_BYTES,
        max_bin_len=limits.MAX_HEADER_BYTES,
        max_array_len=limits.MAX_EVICTED_TILES,
        max_map_len=64,
        max_ext_len=0,
    )
    try:
        unpacker.feed(view[: limits.MAX_HEADER_BYTES])
        header = unpacker.unpack()
    except (ValueError, msgpack.UnpackException) as error:  # cut off, too long, too deep, not UTF-8, not MessagePack
        raise DamagedError(f"header is not readable ({type(error).__name__}: {error})"[:200]) from error
    if type(header) is not dict:
        raise DamagedError(f"header is a {type(header).__name__}, expected a map")
    return header, unpacker.tell()


def _map(pairs: list[tuple[Any, Any]]) -> dict[Any, Any]:
    """A map of text, bytes and integers. Python takes other keys, of which some equal integers."""
    if any(type(key) not in (str, int, bytes) for key, _ in pairs):
        raise ValueError("a key is neither text nor bytes nor an integer")
    return dict(pairs)


def _check_version(header: Header) -> None:
    version = header.get("version")
    if type(version) is int and version not in limits.SUPPORTED_VERSIONS:
        raise VersionError(version)


def _build(spec: _Spec, header: Header, payload: memoryview) -> Message:
    values: dict[str, Any] = {}
    numbered = _TYPE in header
    for number, (name, kind, default) in enumerate(spec.fields, start=1):
        key = number if numbered else name
        if key in header:
            values[name] = kind.unpack(header[key], name)
        elif default is dataclasses.MISSING:
            raise ProtocolError(f"{spec.cls.TAG}: {name} is missing")
    if spec.cls.PAYLOAD == NO_PAYLOAD and len(payload):
        raise ProtocolError(f"{spec.cls.TAG} carries no payload, but {len(payload)} bytes follow")
    if spec.cls.PAYLOAD not in (NO_PAYLOAD, OPAQUE):
        values[spec.cls.PAYLOAD] = bytes(payload)
    return spec.cls(**values)


def _check_payload(message: Message, size: int) -> None:
    """Check that the lengths in a header add up to the payload's."""
    if isinstance(message, TileLayers):
        count = message.to_lod - message.from_lod
        if count < 1 or len(message.sizes) != count or len(message.crcs) not in (0, count):
            raise ProtocolError(
                f"tile: LoDs {message.from_lod}..{message.to_lod} need {max(count, 1)} sizes and as many crcs or none, "
                f"got {len(message.sizes)} and {len(message.crcs)}"
            )
        if sum(message.sizes) != size:
            raise ProtocolError(f"tile: sizes add up to {sum(message.sizes)} bytes, the payload has {size}")
    elif isinstance(message, Blob):
        _check_part(message.TAG, message.offset, size, message.total, may_be_empty=message.total == 0)
    elif isinstance(message, Fragment):
        _check_part(message.TAG, message.offset, size, message.total or size, may_be_empty=False)


def _check_part(tag: str, offset: int, size: int, total: int, *, may_be_empty: bool) -> None:
    if offset + size > total or not (size or may_be_empty):
        raise ProtocolError(f"{tag}: bytes {offset} + {size} do not lie in a total of {total}")
