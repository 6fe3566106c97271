"""The messages of the wire protocol; :mod:`cags_protocol.wire.encoding` turns them into bytes and back.

One message is a MessagePack map (the header) followed by the payload's bytes. The header's first entry is the type, its
last one the CRC-32 of everything else, header and payload, because a flipped byte makes Draco decode wrongly without
an error. Rare messages have text keys; those that go in every frame have numbers, which leaves thin links more room.
Unknown header entries are ignored, unknown types refused; see ``docs/wire.md``.

Times named ``_us`` are microseconds of the client's clock unless a docstring says otherwise.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import ClassVar

from cags_common.geometry import DEFAULT_NEAR, Intrinsics, Pose
from cags_common.tiles.inventory import InventoryEntry
from cags_common.tiles.lod import MAX_LODS
from cags_protocol.cadence import EVERY_FRAME, LEAST_PERMILLE
from cags_protocol.wire import limits
from cags_protocol.wire.fields import INTRINSICS, POSE, Choice, Flag, Integer, ListOf, Real, Record, Text, wire

Buffer = bytes | bytearray | memoryview

_TIME = Integer(2**62)
_FRAME = Integer(2**31 - 1)
_TILE = Integer(2**16 - 1)
_LOD = Integer(MAX_LODS)
_SEQ = Integer(2**53)
_BYTES = Integer(2**53)
_CRC = Integer(2**32 - 1)
_CADENCE = Integer(EVERY_FRAME, LEAST_PERMILLE)
_TEXT = Text(limits.MAX_TEXT_BYTES)

NO_PAYLOAD, OPAQUE = "", "*"


class Message:
    """Base of all messages. ``TAG`` is the header's ``type``. With a ``CODE`` the type is that number, and a field's
    key is its place among the fields, from 1: new fields go last.

    ``PAYLOAD`` is ``NO_PAYLOAD``, ``OPAQUE`` (given to :func:`encode` and returned by :func:`decode` beside the
    message) or the name of the bytes field that travels as the payload.
    """

    __slots__ = ()
    TAG: ClassVar[str]
    CODE: ClassVar[int | None] = None
    PAYLOAD: ClassVar[str] = NO_PAYLOAD


@dataclass(frozen=True, slots=True)
class PoseSample:
    """The client's camera was at ``pose`` (T_world_camera) at ``t_us``."""

    t_us: int
    pose: Pose


@dataclass(frozen=True, slots=True)
class SeqRange:
    """Packet numbers ``first`` .. ``last``, both included."""

    first: int
    last: int

    def __post_init__(self) -> None:
        if self.first > self.last:
            raise ValueError(f"range {self.first}..{self.last} is empty")


_SAMPLE = Record(PoseSample, ("t_us", "pose"), (_TIME, POSE))
_HELD = Record(InventoryEntry, ("frame", "tile", "lods"), (_FRAME, _TILE, _LOD))
_RANGE = Record(SeqRange, ("first", "last"), (_SEQ, _SEQ))

# ---------------------------------------------------------------------------------------------------- client to server

REFERENCES_WANTED = ANY_REFERENCE, PICTURES_ONLY, NO_REFERENCES = "any", "picture", "none"
"""Which references a client can use."""

CHROMAS = FULL_CHROMA, HALF_CHROMA = "yuv444p", "yuv420p"
"""Colour samplings of reference video, the finer one first; a decoder of one takes those after it too."""


@dataclass(frozen=True, slots=True)
class Hello(Message):
    """The first message: who joins, through which camera, and from which media frame.

    ``resume`` names an earlier session of this client (empty: none) and ``inventory`` what it still holds of it
    (:mod:`cags_protocol.wire.inventory`); nothing listed there is sent again. ``references`` says which the client can
    use (``any``: differences too), ``chroma`` the finest colour sampling that its video decoder takes.
    """

    TAG = "hello"
    PAYLOAD = "inventory"
    version: int = wire(Integer(2**16))
    intrinsics: Intrinsics = wire(INTRINSICS)  # noqa: RUF009 - the kinds are immutable
    pose: Pose = wire(POSE)  # noqa: RUF009 - the kinds are immutable
    near: float = wire(Real(1e-6, 1e6), DEFAULT_NEAR)
    start_frame: int = wire(_FRAME, 0)
    token: str = wire(_TEXT, "")
    agent: str = wire(_TEXT, "")
    resume: str = wire(_TEXT, "")
    references: str = wire(Choice(REFERENCES_WANTED), REFERENCES_WANTED[0])
    chroma: str = wire(Choice(CHROMAS), CHROMAS[0])
    inventory: bytes = b""


@dataclass(frozen=True, slots=True)
class PoseBatch(Message):
    """Poses since the last batch, oldest first, and how many of 1,000 media frames the client displays.

    Which ones they are, :mod:`cags_protocol.cadence` says.
    """

    TAG = "poses"
    CODE = 8
    samples: tuple[PoseSample, ...] = wire(ListOf(_SAMPLE, limits.MAX_POSE_SAMPLES))
    cadence_permille: int = wire(_CADENCE, EVERY_FRAME)


@dataclass(frozen=True, slots=True)
class Ack(Message):
    """What arrived on this connection: packet numbers, newest range first (over TCP there is one range).

    ``received_us`` is when the newest packet arrived, ``delay_us`` how long the acknowledgement waited since;
    ``buffered_bytes`` what the client holds undecoded; ``evicted`` what its store dropped (``lods`` = what is left).
    """

    TAG = "ack"
    CODE = 7
    ranges: tuple[SeqRange, ...] = wire(ListOf(_RANGE, limits.MAX_ACK_RANGES))
    received_us: int = wire(_TIME)
    delay_us: int = wire(_TIME, 0)
    buffered_bytes: int = wire(_BYTES, 0)
    evicted: tuple[InventoryEntry, ...] = wire(ListOf(_HELD, limits.MAX_EVICTED_TILES), ())


CONTROL_ACTIONS = ("play", "pause", "seek", "rate")


@dataclass(frozen=True, slots=True)
class Control(Message):
    """The viewer's wish, as the whole state of play: media frame ``frame`` is displayed at ``at_us``.

    While playing, frame i is displayed at ``at_us + (i - frame) * 1e6 / (fps * rate)``; with ``loop`` the first
    follows the last. With ``keeps`` the client goes on holding what it was sent of a group of frames when it jumps or
    loops within it, so that nothing of it is sent again.
    """

    TAG = "control"
    action: str = wire(Choice(CONTROL_ACTIONS))
    frame: int = wire(_FRAME)
    at_us: int = wire(_TIME)
    rate: float = wire(Real(0.01, 16.0), 1.0)
    loop: bool = wire(Flag(), False)
    keeps: bool = wire(Flag(), False)


@dataclass(frozen=True, slots=True)
class KeyframeRequest(Message):
    """The reference video is broken after ``reference_seq`` (the last one decoded; 0: none): send an IDR picture."""

    TAG = "keyframe"
    reference_seq: int = wire(_SEQ)


# ------------------------------------------------------------------------------------------------------ both directions


@dataclass(frozen=True, slots=True)
class Bye(Message):
    """The sender leaves; nothing follows."""

    TAG = "bye"
    reason: str = wire(_TEXT, "")


@dataclass(frozen=True, slots=True)
class Ping(Message):
    """Keep-alive; answered by a :class:`Pong` of the same ``t_us`` (the sender's clock)."""

    TAG = "ping"
    t_us: int = wire(_TIME)


@dataclass(frozen=True, slots=True)
class Pong(Message):
    """Answer to a :class:`Ping`."""

    TAG = "pong"
    t_us: int = wire(_TIME)


# ---------------------------------------------------------------------------------------------------- server to client


@dataclass(frozen=True, slots=True)
class Welcome(Message):
    """The session is open. ``info`` is the public part of the bundle's manifest (JSON, UTF-8).

    ``resumed`` says that the inventory of the :class:`Hello` was taken over.
    """

    TAG = "welcome"
    PAYLOAD = "info"
    session: str = wire(_TEXT)
    fps: float = wire(Real(0.01, 1000.0))
    frames: int = wire(_FRAME)
    resumed: bool = wire(Flag(), False)
    info: bytes = b""


@dataclass(frozen=True, slots=True)
class Blob(Message):
    """Bytes ``offset`` .. of the blob ``name`` (codebooks, weights), which has ``total`` bytes in all."""

    TAG = "blob"
    PAYLOAD = OPAQUE
    name: str = wire(_TEXT)
    offset: int = wire(Integer(limits.MAX_BLOB_BYTES))
    total: int = wire(Integer(limits.MAX_BLOB_BYTES))


@dataclass(frozen=True, slots=True)
class TileLayers(Message):
    """LoDs ``from_lod`` .. ``to_lod`` - 1 of a tile: the payload is their payloads, one after another.

    A tile brings looks, motion or updates (:mod:`cags_common.tiles.kinds`); the first byte of its LoD 0 says which.
    ``sizes`` has one entry a LoD. So has ``crcs`` (CRC-32, as in the bundle) in messages of versions before 4; later
    ones leave it out.
    """

    TAG = "tile"
    CODE = 2
    PAYLOAD = OPAQUE
    frame: int = wire(_FRAME)
    tile: int = wire(_TILE)
    from_lod: int = wire(_LOD)
    to_lod: int = wire(_LOD)
    sizes: tuple[int, ...] = wire(ListOf(Integer(limits.MAX_MESSAGE_BYTES), MAX_LODS))
    crcs: tuple[int, ...] = wire(ListOf(_CRC, MAX_LODS), ())

    def split(self, payload: Buffer) -> list[memoryview]:
        """The payload of each LoD, without copying."""
        view, out, start = memoryview(payload), [], 0
        for size in self.sizes:
            out.append(view[start : start + size])
            start += size
        return out


class ReferenceKind(StrEnum):
    """What a reference says."""

    DIFFERENCE = "difference"
    """What the client lacks: the true view minus that of the client's splats, companded."""
    PICTURE = "picture"
    """The true view."""
    NOTHING = "nothing"
    """The client's splats are as good as a reference could make them; there is no payload."""


@dataclass(frozen=True, slots=True)
class ReferenceFrame(Message):
    """The reference of media frame ``frame``, made at ``pose`` (T_world_camera): one H.264 access unit.

    ``seq`` counts pictures from 1 without gaps; an ``idr`` picture needs none before it. ``basis`` is the
    :class:`Mark` that it assumes, ``knee`` that of a difference's compander
    (:mod:`cags_common.correction.compander`), ``error`` the mean squared error that coding has left in a picture
    ([0, 1] RGB), ``reach`` how far from ``pose`` a difference holds, radians (:mod:`cags_common.correction.reach`).
    One that says nothing has the ``seq`` of the last picture.
    """

    TAG = "reference"
    CODE = 3
    PAYLOAD = OPAQUE
    frame: int = wire(_FRAME)
    seq: int = wire(_SEQ)
    pose: Pose = wire(POSE)  # noqa: RUF009 - the kinds are immutable
    intrinsics: Intrinsics = wire(INTRINSICS)  # noqa: RUF009 - the kinds are immutable
    idr: bool = wire(Flag(), False)
    kind: str = wire(Choice(tuple(ReferenceKind)), ReferenceKind.PICTURE.value)
    basis: int = wire(_SEQ, 0)
    knee: float = wire(Real(1e-3, 10.0), 0.1)
    error: float = wire(Real(0.0, 1.0), 0.0)
    reach: float = wire(Real(0.0, 10.0), 0.2)


@dataclass(frozen=True, slots=True)
class Mark(Message):
    """What was sent before this on the connection is the basis ``number``: references are made from it.

    Numbers rise by one, from 1. With ``restart`` the client holds nothing of what came before: the answer to a jump by
    which it forgot everything.
    """

    TAG = "mark"
    CODE = 4
    number: int = wire(_SEQ)
    restart: bool = wire(Flag(), False)


@dataclass(frozen=True, slots=True)
class FrameEnd(Message):
    """The server plans nothing more for ``frame`` for now. Payload: ids removed at that frame (may be empty)."""

    TAG = "frame_end"
    CODE = 5
    PAYLOAD = OPAQUE
    frame: int = wire(_FRAME)


@dataclass(frozen=True, slots=True)
class Notice(Message):
    """Something the viewer or a log should know; the session goes on."""

    TAG = "notice"
    code: str = wire(_TEXT)
    message: str = wire(_TEXT)


class RefusalCode(StrEnum):
    """Why a server of this version ends a session; a client takes a code that it does not know for a passing one."""

    VERSION = "version"
    TOKEN = "token"  # noqa: S105 - the name of a reason, not a secret
    FULL = "full"
    MALFORMED = "malformed"
    UNEXPECTED = "unexpected"
    QUOTA = "quota"
    TIMEOUT = "timeout"
    INTERNAL = "internal"


@dataclass(frozen=True, slots=True)
class Refusal(Message):
    """The session ends by the server's decision. Every version of the protocol can read this message.

    ``code`` is a :class:`RefusalCode` or one of a later version, ``field`` names what was wrong (may be empty).
    """

    TAG = "refusal"
    code: str = wire(_TEXT)
    field: str = wire(_TEXT)
    message: str = wire(_TEXT)


@dataclass(frozen=True, slots=True)
class Fragment(Message):
    """Packet ``seq`` of this connection: bytes ``offset`` .. of the encoded message ``ident`` of ``total`` bytes.

    A message of one fragment leaves ``total`` out (0).
    """

    TAG = "fragment"
    CODE = 1
    PAYLOAD = OPAQUE
    seq: int = wire(_SEQ)
    ident: int = wire(_SEQ)
    offset: int = wire(Integer(limits.MAX_MESSAGE_BYTES), 0)
    total: int = wire(Integer(limits.MAX_MESSAGE_BYTES), 0)


@dataclass(frozen=True, slots=True)
class Abandon(Message):
    """No more fragments of these messages will come."""

    TAG = "abandon"
    CODE = 6
    idents: tuple[int, ...] = wire(ListOf(_SEQ, limits.MAX_PARTIAL_MESSAGES))


CLIENT_MESSAGES: tuple[type[Message], ...] = (Hello, PoseBatch, Ack, Control, KeyframeRequest, Bye, Ping, Pong)
SERVER_DATA: tuple[type[Message], ...] = (Blob, TileLayers, ReferenceFrame, FrameEnd, Mark)
SERVER_MESSAGES: tuple[type[Message], ...] = (
    Welcome, Notice, Refusal, Fragment, Abandon, Bye, Ping, Pong, *SERVER_DATA,
)  # fmt: skip
