"""Decoded references, matched to the frames that are shown."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from functools import cached_property

from cags_client.store.picture import ReferencePicture
from cags_common.correction import Reference
from cags_common.errors import DecodeError
from cags_common.geometry import DEFAULT_NEAR, F32, Camera
from cags_common.video.h264 import H264Decoder
from cags_protocol.wire.messages import ReferenceFrame, ReferenceKind

KEPT = 24
"""References kept: those sent ahead of display and the last few shown."""

LATEST = 0.25
"""A reference is late by at most this share of the clip; in a loop, any other belongs to the next round."""

MAX_REFERENCE_PIXELS = 1 << 21
"""Largest reference that is decoded."""


@dataclass(frozen=True, eq=False)
class Received:
    """A reference as it came."""

    frame: int
    order: int
    """Counts references as they come, over all connections."""
    basis: int
    """Mark of the client's store that it assumes."""
    camera: Camera
    kind: ReferenceKind
    coded: F32 | None = None  # [h, w, 3] in [0, 1]; None where it says nothing
    knee: float = 0.1
    error: float = 0.0
    """Mean squared error that coding has left in a picture, [0, 1] RGB."""
    seq: int = 0

    @property
    def assumes(self) -> bool:
        """Whether it is right for its basis alone; a picture is compared with whatever the client holds."""
        return self.kind is not ReferenceKind.PICTURE

    @cached_property
    def reference(self) -> Reference:
        """What correctors take."""
        assert self.coded is not None, "a reference that says nothing corrects nothing"
        picture = self.kind is ReferenceKind.PICTURE
        return Reference(self.coded, self.camera, picture, self.knee, self.error if picture else 0.0)

    @cached_property
    def picture(self) -> ReferencePicture | None:
        """What aligners take; None of a difference."""
        if self.kind is not ReferenceKind.PICTURE or self.coded is None:
            return None
        return ReferencePicture(self.coded, self.camera, self.frame, self.seq)


class References:
    """Decodes the reference video and hands out what is for a frame. Decoding and reading may be in two threads."""

    def __init__(self, near: float = DEFAULT_NEAR) -> None:
        self._decoder = H264Decoder(max_pixels=MAX_REFERENCE_PIXELS)
        self._near = near
        self._last_seq = self._order = 0
        self.last_decoded = 0
        """Sequence number of the last picture that was decoded; 0 before any."""
        self._received: dict[int, Received] = {}
        self._to_come: set[int] = set()  # their frames that were not reached yet
        self._frame = -1  # on display
        self._lock = threading.Lock()

    def add(self, message: ReferenceFrame, access_unit: memoryview, basis: int) -> bool:
        """Decode one reference, which assumes mark ``basis`` of the store. Returns whether the video is whole: if not,
        an IDR picture is needed.

        A gap in the sequence makes every picture up to the next IDR wrong without an error, so they are not shown.
        Raises :class:`DecodeError`.
        """
        kind, coded = ReferenceKind(message.kind), None
        if kind is ReferenceKind.NOTHING:
            if len(access_unit):
                raise DecodeError(f"reference of frame {message.frame} says nothing in {len(access_unit)} bytes")
        else:
            if message.seq <= self._last_seq and not message.idr:
                return True  # late: the decoder is past it
            coded = self._decoded(message, access_unit)
            if coded is None:
                return False
        camera = Camera(message.intrinsics, message.pose, self._near)
        with self._lock:
            self._order += 1
            self._received.pop(message.frame, None)
            self._received[message.frame] = Received(
                message.frame, self._order, basis, camera, kind, coded, message.knee, message.error, message.seq
            )
            self._to_come.add(message.frame)
            while len(self._received) > KEPT:
                oldest = next(iter(self._received))
                del self._received[oldest]
                self._to_come.discard(oldest)
        return True

    def _decoded(self, message: ReferenceFrame, access_unit: memoryview) -> F32 | None:
        if message.seq != self._last_seq + 1 and not message.idr:
            self._decoder.reset()
        self._last_seq = message.seq
        rgb = self._decoder.decode(access_unit)
        if rgb is None:
            return None
        i = message.intrinsics
        if rgb.shape[:2] != (i.height_px, i.width_px):
            raise DecodeError(
                f"reference {message.seq} is {rgb.shape[1]}x{rgb.shape[0]}, said {i.width_px}x{i.height_px}"
            )
        self.last_decoded = message.seq
        return rgb

    def show(self, frame: int, frames: int) -> None:
        """Display media frame ``frame`` of a clip of ``frames``; :meth:`newest` and :meth:`next_basis` speak of it.

        Each round of a loop has its own references. A reference whose frame was displayed or skipped is not awaited any
        more, and it is dropped when the next round begins, where it would be wrong.
        """
        with self._lock:
            coming = {f: self._received[f] for f in self._to_come}
            reached = {} if frame < self._frame else self._received
            self._frame = frame
            self._to_come = {f for f in coming if 0 < (f - frame) % frames < frames / 2}
            self._received = {
                f: r
                for f, r in {**reached, **coming}.items()
                if f <= frame or f in self._to_come or (frame - f) % frames > LATEST * frames
            }

    def newest(self, max_age: int) -> Received | None:
        """The reference of the frame on display, or the newest one of the ``max_age`` frames before it."""
        with self._lock:
            past = [f for f in self._received if f not in self._to_come and 0 <= self._frame - f <= max_age]
            return self._received[max(past)] if past else None

    def next_basis(self) -> int | None:
        """The mark that the next references assume, of those that have come for later frames than that on display. None
        where none has come, or they assume nothing.
        """
        with self._lock:
            waiting = [self._received[f] for f in self._to_come]
            return min((r.basis for r in waiting if r.assumes), default=None)

    def restart(self) -> None:
        """Another server's video follows, numbered from 1; what is there stays."""
        self._decoder.reset()
        self._last_seq = self.last_decoded = 0

    @property
    def count(self) -> int:
        """References that have come so far, over all connections."""
        return self._order

    def reset(self, until: int | None = None) -> None:
        """Forget everything (the viewer jumped), or the first ``until`` that came; the decoder goes on."""
        with self._lock:
            kept = {f: r for f, r in self._received.items() if until is not None and r.order > until}
            self._received = kept
            self._to_come &= kept.keys()
