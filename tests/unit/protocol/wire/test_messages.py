import zlib
from dataclasses import replace

import msgpack
import pytest

from cags_common.errors import ProtocolError
from cags_common.geometry import Intrinsics, Pose
from cags_common.tiles.inventory import InventoryEntry
from cags_protocol.wire import limits
from cags_protocol.wire import messages as m
from cags_protocol.wire.encoding import DamagedError, VersionError, decode, encode, printable
from support.wire_pair import hello

POSE = Pose((1.0, 2.0, 3.0), (0.5, 0.5, 0.5, 0.5))
CAMERA = Intrinsics.of_fov(400, 300, 1.0, 0.8)

EXAMPLES: list[tuple[m.Message, bytes]] = [
    (hello(token="secret", start_frame=7, inventory=b"\1\2"), b""),
    (hello(references="picture", chroma="yuv420p"), b""),
    (m.PoseBatch((m.PoseSample(1, POSE), m.PoseSample(2, Pose.identity()))), b""),
    (m.Ack((m.SeqRange(5, 9), m.SeqRange(1, 3)), 77, 5, 100, (InventoryEntry(1, 2, 3),)), b""),
    (m.Control("seek", 12, 99, 0.5, True), b""),
    (m.KeyframeRequest(4), b""),
    (m.Bye("done"), b""),
    (m.Ping(3), b""),
    (m.Pong(3), b""),
    (m.Welcome("s1", 29.97, 300, info=b'{"name": "x"}'), b""),
    (m.Blob("codebooks", 4, 10), b"abcdef"),
    (m.TileLayers(3, 1, 0, 2, (3, 1), (1, 2)), b"abcd"),
    (m.ReferenceFrame(3, 9, POSE, CAMERA, True), b"\0\0\1"),
    (m.ReferenceFrame(3, 9, POSE, CAMERA, kind="difference", basis=7, knee=0.06), b"\0\0\1"),
    (m.ReferenceFrame(3, 9, POSE, CAMERA, kind="nothing", basis=7), b""),
    (m.Mark(7), b""),
    (m.Mark(8, restart=True), b""),
    (m.FrameEnd(3), b"\5"),
    (m.FrameEnd(3), b""),
    (m.Notice("slow", "the link is slow"), b""),
    (m.Refusal("full", "", "16 clients at most"), b""),
    (m.Fragment(1, 2, 0, 5), b"hello"),
    (m.Abandon((4, 5)), b""),
]


VIEW = [400, 300, 400.0, 400.0, 200.0, 150.0]
HELLO = {"type": "hello", "version": limits.PROTOCOL_VERSION, "intrinsics": VIEW, "pose": [0, 0, 0, 1, 0, 0, 0]}
REFERENCE = {"type": "reference", "frame": 0, "seq": 1, "pose": [0, 0, 0, 1, 0, 0, 0], "intrinsics": VIEW}


def pack(header: dict[str, object], payload: bytes = b"") -> bytes:
    """A message of any header, with the right crc."""
    head = msgpack.packb({**header, "crc": 0xFFFFFFFF})[:-4]
    return head + zlib.crc32(payload, zlib.crc32(head)).to_bytes(4, "big") + payload


@pytest.mark.parametrize(("message", "payload"), EXAMPLES, ids=lambda v: getattr(v, "TAG", None))
def test_a_message_comes_back_as_it_went(message, payload):
    decoded, rest = decode(encode(message, payload))
    assert decoded == message
    assert bytes(rest) == payload


def test_every_message_has_an_example():
    assert {type(message) for message, _ in EXAMPLES} == {*m.CLIENT_MESSAGES, *m.SERVER_MESSAGES}


@pytest.mark.parametrize(("message", "payload"), EXAMPLES, ids=lambda v: getattr(v, "TAG", None))
def test_every_flipped_byte_is_noticed(message, payload):
    data = encode(message, payload)
    for index in range(len(data)):
        broken = bytearray(data)
        broken[index] ^= 0x41
        with pytest.raises(ProtocolError):
            decode(broken)


@pytest.mark.parametrize(("message", "payload"), EXAMPLES, ids=lambda v: getattr(v, "TAG", None))
def test_every_truncation_is_refused(message, payload):
    data = encode(message, payload)
    for end in range(len(data)):
        with pytest.raises(ProtocolError):
            decode(data[:end])


def test_the_payload_is_not_copied():
    data = encode(m.FrameEnd(1), b"payload")
    assert decode(data)[1].obj is data


def test_unknown_header_entries_are_ignored():
    assert decode(pack({"type": "ping", "t_us": 5, "colour": "red"}))[0] == m.Ping(5)


def test_records_may_grow():
    data = pack({"type": "ack", "ranges": [[1, 2, "later"]], "received_us": 3})
    assert decode(data)[0] == m.Ack((m.SeqRange(1, 2),), 3)


@pytest.mark.parametrize(
    ("header", "says"),
    [
        ({"type": "teleport"}, "'teleport' is not a known message"),
        ({"type": 5}, "5 is not a known message"),
        ({}, "None is not a known message"),
        ({"type": "ping"}, "t_us is missing"),
        ({"type": "ping", "t_us": -1}, "t_us = -1 must be an integer"),
        ({"type": "ping", "t_us": True}, "t_us = True must be an integer"),
        ({"type": "ping", "t_us": 1.0}, "t_us = 1.0 must be an integer"),
        ({"type": "control", "action": "explode", "frame": 0, "at_us": 0}, "one of play, pause, seek, rate"),
        ({"type": "control", "action": "play", "frame": 0, "at_us": 0, "rate": float("nan")}, "rate = nan"),
        ({"type": "control", "action": "play", "frame": 0, "at_us": 0, "loop": 1}, "true or false"),
        ({"type": "bye", "reason": "a\nforged log line"}, "printable"),
        ({"type": "bye", "reason": b"bytes"}, "printable"),
        ({"type": "ack", "ranges": [[3, 1]], "received_us": 0}, "range 3..1 is empty"),
        ({"type": "ack", "ranges": [[3]], "received_us": 0}, "list of at least 2"),
        ({"type": "ack", "ranges": [[1, 1]] * 33, "received_us": 0}, "at most 32"),
        ({"type": "poses", "samples": [[0, [0, 0, 0, 2, 0, 0, 0]]]}, "samples.pose"),
        ({"type": "poses", "samples": [[0, [0, 0, 0, 0.5, 0, 0, 0]]]}, "unit quaternion"),
        ({"type": "poses", "samples": [[0, [0, 0, float("inf"), 1, 0, 0, 0]]]}, "samples.pose"),
        ({"type": "poses", "samples": [[0, [0, 0, 0]]]}, "seven numbers"),
        ({**HELLO, "intrinsics": [0, 1, 1, 1, 0, 0]}, "width_px"),
        ({**HELLO, "references": "all"}, "references = 'all' must be one of any, picture, none"),
        ({**HELLO, "chroma": "yuv422p"}, "chroma = 'yuv422p' must be one of yuv444p, yuv420p"),
        ({**REFERENCE, "kind": "sketch"}, "kind = 'sketch' must be one of difference, picture, nothing"),
        ({**REFERENCE, "knee": 0.0}, "knee = 0.0"),
        ({**REFERENCE, "basis": -1}, "basis = -1"),
        ({"type": "mark"}, "number is missing"),
        ({"type": "mark", "number": 1, "restart": 1}, "true or false"),
    ],
)
def test_wrong_headers_are_refused_by_name(header, says):
    with pytest.raises(ProtocolError) as error:
        decode(pack(header))
    assert says in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\xc1",
        b"\x90",
        b"\x81\xa4type",
        b"\xdf\xff\xff\xff\xff",
        b"\xdd\xff\xff\xff\xff",
        b"\x91" * 5000,
        b"hello",
        b"\xc6\xff\xff\xff\xff",
    ],
    ids=lambda data: repr(data[:6]),
)
def test_what_is_no_header_is_refused(data):
    with pytest.raises(DamagedError):
        decode(data)


def test_a_header_without_crc_is_refused():
    with pytest.raises(DamagedError, match="crc"):
        decode(msgpack.packb({"type": "ping", "t_us": 1}))


def test_a_hello_of_another_version_names_both():
    with pytest.raises(VersionError, match=rf"version = 9 .*speaks {limits.PROTOCOL_VERSION}") as error:
        decode(pack({"type": "hello", "version": 9, "camera": "holographic"}))
    assert error.value.theirs == 9


@pytest.mark.parametrize(
    ("message", "payload"),
    [
        (m.TileLayers(0, 0, 0, 2, (1,), (1,)), b"a"),
        (m.TileLayers(0, 0, 2, 2, (), ()), b""),
        (m.TileLayers(0, 0, 0, 1, (2,), (0,)), b"a"),
        (m.Blob("b", 5, 8), b"abcd"),
        (m.Fragment(1, 1, 0, 4), b""),
        (m.Ping(1), b"extra"),
        (m.Welcome("s", 0.0, 1), b""),
        (replace(hello(), token="\x07"), b""),
        (m.Ack(tuple(m.SeqRange(i, i) for i in range(33)), 0), b""),
    ],
    ids=lambda v: getattr(v, "TAG", None),
)
def test_what_must_not_travel_is_not_encoded(message, payload):
    with pytest.raises(ProtocolError):
        encode(message, payload)


def test_a_payload_on_a_message_without_one_is_refused():
    with pytest.raises(ProtocolError, match="carries no payload, but 3 bytes follow"):
        decode(pack({"type": "ping", "t_us": 1}, b"abc"))


def test_the_largest_fragment_header_fits_its_room():
    top = limits.MAX_MESSAGE_BYTES
    data = encode(m.Fragment(2**53, 2**53, top - 1, top), b"x")
    from cags_protocol.delivery.send_queue import FRAGMENT_HEADER_BYTES

    assert len(data) - 1 <= FRAGMENT_HEADER_BYTES


def test_printable_makes_any_text_sendable():
    text = printable("line\nbreak " + "ü" * 2000)
    assert decode(encode(m.Bye(text)))[0] == m.Bye(text)
    assert text.startswith("line?break")


def test_tile_layers_split_gives_views():
    parts = m.TileLayers(0, 0, 1, 3, (2, 3), (0, 0)).split(b"abcde")
    assert [bytes(p) for p in parts] == [b"ab", b"cde"]
