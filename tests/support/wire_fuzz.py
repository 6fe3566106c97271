"""Messages gone wrong: bytes changed, and whole headers changed under a right CRC, so that decoding gets past it."""

from __future__ import annotations

import copy
import random
import zlib
from typing import Any

import msgpack

from cags_common.geometry import Pose
from cags_protocol.wire import messages as m
from cags_protocol.wire.encoding import decode, encode
from support.wire_pair import INTRINSICS, hello

SEEDS: list[tuple[m.Message, bytes]] = [
    (hello(inventory=b"\1\0\0\0\2\0\3"), b""),
    (m.PoseBatch((m.PoseSample(1, Pose.identity()),)), b""),
    (m.Ack((m.SeqRange(3, 4), m.SeqRange(1, 1)), 2, 1, 5, (m.InventoryEntry(0, 0, 1),)), b""),
    (m.Control("seek", 4, 9, 2.0, True), b""),
    (m.KeyframeRequest(4), b""),
    (m.Bye("x"), b""),
    (m.Ping(4), b""),
    (m.Pong(4), b""),
    (m.Welcome("s", 30.0, 10, info=b"{}"), b""),
    (m.Blob("b", 0, 9), b"123"),
    (m.TileLayers(0, 0, 0, 2, (1, 2), (3, 4)), b"abc"),
    (m.ReferenceFrame(0, 1, Pose.identity(), INTRINSICS, True), b"h264"),
    (m.FrameEnd(3), b"\0"),
    (m.Fragment(1, 1, 0, 9), b"abc"),
    (m.Abandon((1,)), b""),
    (m.Refusal("full", "", "no"), b""),
]

ODD: list[Any] = [
    None, True, -1, 0, 1, 2**31, 2**63 - 1, 2**64 - 1, -(2**63), 0.5, float("nan"), float("inf"),
    "", "x" * 2000, "\n\x00", b"", b"\xff" * 50, [], [[]], [1] * 600, {}, {"a": {}}, [[[[0]]]], "hello", "fragment",
]  # fmt: skip


def fuzzed(rng: random.Random) -> bytes:
    """One message that is probably wrong."""
    message, payload = rng.choice(SEEDS)
    data = encode(message, payload)
    if rng.random() < 0.5:
        return _changed_bytes(rng, data)
    header = msgpack.unpackb(data[: len(data) - len(decode(data)[1])], strict_map_key=False) if _whole(data) else {}
    header.pop("crc", None)
    for _ in range(rng.randrange(1, 4)):
        _change_header(rng, header)
    if rng.random() < 0.2:
        payload = rng.randbytes(rng.randrange(40))
    head = msgpack.packb({**header, "crc": 0xFFFFFFFF})[:-4]
    return head + zlib.crc32(payload, zlib.crc32(head)).to_bytes(4, "big") + payload


def _whole(data: bytes) -> bool:
    """Whether the header is all there is but an opaque payload (a payload field is not told apart by decode)."""
    message, _ = decode(data)
    return message.PAYLOAD in (m.NO_PAYLOAD, m.OPAQUE)


def _changed_bytes(rng: random.Random, data: bytes) -> bytes:
    out = bytearray(data)
    for _ in range(rng.randrange(1, 5)):
        where = rng.randrange(len(out) + 1)
        match rng.randrange(4):
            case 0 if where < len(out):
                out[where] = rng.randrange(256)
            case 1:
                out[where:where] = rng.randbytes(rng.randrange(1, 9))
            case 2:
                del out[where : where + rng.randrange(1, 9)]
            case _:
                del out[where:]
    return bytes(out)


def _change_header(rng: random.Random, header: dict[str, Any]) -> None:
    keys = list(header) or ["type"]
    key = rng.choice(keys)
    match rng.randrange(5):
        case 0:
            header.pop(key, None)
        case 1:
            header[rng.choice(["x", "type", *keys])] = copy.deepcopy(rng.choice(ODD))
        case 2 if isinstance(header.get(key), list) and header[key]:
            header[key][rng.randrange(len(header[key]))] = copy.deepcopy(rng.choice(ODD))
        case 3 if isinstance(header.get(key), int):
            header[key] = rng.choice(
                [header[key] % 2**40 + 1, -(header[key] % 2**40), header[key] % 2**40 * 1000, 2**53, 2**53 + 1]
            )
        case _:
            header[key] = copy.deepcopy(rng.choice(ODD))
