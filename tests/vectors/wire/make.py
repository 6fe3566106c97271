"""Write a vector file of the current protocol version: ``python tests/vectors/wire/make.py FILE``.

A file that is committed is never written again: a change of the wire adds entries or a new file.
"""

from __future__ import annotations

import dataclasses
import json
import sys
import zlib
from pathlib import Path

import msgpack

from cags_common.geometry import Intrinsics, Pose
from cags_common.tiles.inventory import InventoryEntry
from cags_protocol.wire import messages as m
from cags_protocol.wire.encoding import decode, encode
from cags_protocol.wire.inventory import pack_inventory

POSE = Pose((0.25, -1.5, 3.0), (0.5, 0.5, -0.5, 0.5))
CAMERA = Intrinsics(1600, 1200, 1385.5, 1385.5, 800.0, 600.0)

MESSAGES: list[tuple[str, m.Message, bytes]] = [
    ("hello", m.Hello(4, CAMERA, POSE), b""),
    (
        "hello resuming",
        m.Hello(
            4,
            CAMERA,
            POSE,
            0.1,
            30,
            "token",
            "cags-client 0.1.0",
            "s-1",
            inventory=pack_inventory([InventoryEntry(30, 2, 5)]),
        ),
        b"",
    ),
    ("hello of a viewer with a plain decoder", m.Hello(4, CAMERA, POSE, references="picture", chroma="yuv420p"), b""),
    ("poses", m.PoseBatch((m.PoseSample(1_000_000, POSE), m.PoseSample(1_027_777, Pose.identity()))), b""),
    ("poses of a client that draws six frames in ten", m.PoseBatch((m.PoseSample(1_000_000, POSE),), 600), b""),
    ("ack", m.Ack((m.SeqRange(9, 12), m.SeqRange(1, 7)), 2**40, 1200, 4096, (InventoryEntry(3, 4, 0),)), b""),
    ("ack, short", m.Ack((m.SeqRange(1, 300),), 5), b""),
    ("control", m.Control("play", 0, 1_500_000), b""),
    ("control, everything", m.Control("rate", 77, 1_500_000, 0.5, True), b""),
    ("keyframe", m.KeyframeRequest(0), b""),
    ("bye", m.Bye("viewer left"), b""),
    ("ping", m.Ping(123), b""),
    ("pong", m.Pong(123), b""),
    ("welcome", m.Welcome("s-1", 30.0, 300, True, b'{"name":"room"}'), b""),
    ("blob", m.Blob("codebooks", 262144, 262150), b"\0\1\2\3\4\5"),
    ("tile", m.TileLayers(31, 7, 1, 3, (2, 1)), b"\xaa\xbb\xcc"),
    ("tile of motion", m.TileLayers(31, 8, 0, 2, (2, 1)), b"\x01\xbb\xcc"),
    (
        "tile of an update, of one attribute alone",
        m.TileLayers(31, 9, 0, 3, (2, 0, 1)),
        b"\x03\xbb\xcc",
    ),
    ("reference, a picture", m.ReferenceFrame(31, 32, POSE, CAMERA, True), b"\0\0\0\1\x67"),
    ("reference, a difference", m.ReferenceFrame(31, 33, POSE, CAMERA, False, "difference", 12, 0.05), b"\0\0\1\x41"),
    ("reference, nothing to say", m.ReferenceFrame(32, 33, POSE, CAMERA, False, "nothing", 13), b""),
    ("mark", m.Mark(12), b""),
    ("mark, after a jump", m.Mark(14, True), b""),
    ("frame end", m.FrameEnd(31), b"\7\0\0\0"),
    ("notice", m.Notice("slow", "the link carries less than the least quality"), b""),
    ("refusal", m.Refusal("version", "version", "version = 1 is not spoken here; this server speaks 4"), b""),
    ("fragment, whole", m.Fragment(1, 1), b"whole"),
    ("fragment, part", m.Fragment(2, 2, 8096, 20000), b"part"),
    ("abandon", m.Abandon((2, 3)), b""),
]


def raw(header: dict[str, object], payload: bytes = b"") -> bytes:
    """A message of any header."""
    return sealed(msgpack.packb({**header, "crc": 0xFFFFFFFF})[:-4], payload)


def numbered(header: dict[int | str, object], payload: bytes = b"", crc: int | str = 127) -> bytes:
    """A message of any header with numbers for keys; its type is entry 0."""
    return sealed(msgpack.packb({**header, crc: 0xFFFFFFFF})[:-4], payload)


def sealed(head: bytes, payload: bytes = b"") -> bytes:
    """A message of a header without the four bytes of its CRC."""
    return head + zlib.crc32(payload, zlib.crc32(head)).to_bytes(4, "big") + payload


LATER: list[tuple[str, m.Message, bytes]] = [
    ("an unknown entry", m.Ping(5), raw({"type": "ping", "t_us": 5, "colour": {"deep": [1, 2.5, None]}})),
    (
        "a record that grew",
        m.Ack((m.SeqRange(1, 2),), 5),
        raw({"type": "ack", "ranges": [[1, 2, 9]], "received_us": 5}),
    ),
    (
        "entries in another order",
        m.Control("pause", 3, 9),
        raw({"at_us": 9, "frame": 3, "action": "pause", "type": "control"}),
    ),
    ("text keys where numbers are usual", m.FrameEnd(9), raw({"type": "frame_end", "frame": 9})),
    (
        "checksums of levels, as before",
        m.TileLayers(1, 2, 0, 1, (1,), (7,)),
        raw({"type": "tile", "frame": 1, "tile": 2, "from_lod": 0, "to_lod": 1, "sizes": [1], "crcs": [7]}, b"x"),
    ),
    ("an unknown number", m.FrameEnd(9), numbered({0: 5, 1: 9, 40: {"deep": [1, {2: None}]}})),
    ("an unknown text among numbers", m.FrameEnd(9), numbered({0: 5, 1: 9, "frame": 3, "crc": 1})),
    ("numbers in another order", m.FrameEnd(9), numbered({1: 9, 0: 5})),
]

HELLO = {"type": "hello", "intrinsics": [1, 1, 1, 1, 0, 0], "pose": [0, 0, 0, 1, 0, 0, 0]}
TILE = {"type": "tile", "frame": 0, "tile": 0, "from_lod": 0, "to_lod": 1}

REFUSED: list[tuple[str, bytes]] = [
    ("an unknown type", raw({"type": "teleport"})),
    ("another version", raw({"type": "hello", "version": 5, "view": "lightfield"})),
    ("the version before", raw({**HELLO, "version": 3})),
    ("a missing field", raw({"type": "ping"})),
    ("a float for an integer", raw({"type": "ping", "t_us": 5.0})),
    ("a payload where none belongs", raw({"type": "ping", "t_us": 5}, b"x")),
    ("sizes that do not add up", raw({**TILE, "sizes": [9], "crcs": [0]}, b"x")),
    ("a crc that does not match", raw({"type": "ping", "t_us": 5})[:-1] + b"\0"),
    ("a cadence that is too slow", raw({"type": "poses", "samples": [], "cadence_permille": 249})),
    ("no crc", msgpack.packb({"type": "ping", "t_us": 5})),
    ("an unknown code", numbered({0: 99, 1: 9})),
    ("a code of a message that has none", numbered({0: "ping", 1: 9})),
    ("a missing field, by number", numbered({0: 5})),
    ("a text crc among numbers", numbered({0: 5, 1: 9}, crc="crc")),
    ("a crc by number among texts", numbered({"type": "frame_end", "frame": 9})),
    ("a float that equals a key", sealed(b"\x83\x00\x05\xcb?\xf0\0\0\0\0\0\0\x09\x7f\xce")),
    ("a flag that equals a key", sealed(b"\x83\x00\x05\xc3\x09\x7f\xce")),
    ("a list for a key", sealed(b"\x83\x00\x05\x91\x01\x09\x7f\xce")),
    ("checksums for some levels", raw({**TILE, "to_lod": 2, "sizes": [1, 0], "crcs": [0]}, b"x")),
]  # fmt: skip


def plain(message: m.Message) -> dict[str, object]:
    """The fields of a message as JSON has them; bytes as hexadecimal."""
    return json.loads(json.dumps(dataclasses.asdict(message), default=lambda b: b.hex()))


def vectors() -> dict[str, object]:
    """Everything a decoder must read or refuse."""
    good = [(name, message, encode(message, payload)) for name, message, payload in MESSAGES] + LATER
    return {
        "version": 4,
        "read": [
            {
                "name": name,
                "type": message.TAG,
                "fields": plain(message),
                "payload": bytes(decode(data)[1]).hex(),
                "data": data.hex(),
            }
            for name, message, data in good
        ],
        "refuse": [{"name": name, "data": data.hex()} for name, data in REFUSED],
    }


if __name__ == "__main__":
    with Path(sys.argv[1]).open("x", encoding="utf-8") as file:
        json.dump(vectors(), file, indent=1)
        file.write("\n")
