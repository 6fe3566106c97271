"""Decoded references, matched to displayed frames."""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass, field
from functools import cached_property

from cags_client.store.picture import ReferencePicture
from cags_common.correction import Reference
from cags_common.correction.reach import HOLDS
from cags_common.correction.trust import doubted
from cags_common.errors import DecodeError
from cags_common.geometry import DEFAULT_NEAR, F32, Camera
from cags_common.video.h264 import H264Decoder
from cags_protocol.wire.messages import ReferenceFrame, ReferenceKind

KEPT = 24
"""Number of references to keep: those ahead of display and the last few displayed."""

LATEST = 0.25
"""Largest lateness of a reference, as a share of the clip; in a loop, later ones belong to the next round."""

BEGINNING = 12
"""Number of frames after a start or a jump for which the displayed levels tell how good the client's splats are: play
begins when the first frame is complete. Later, motion and updates may be missing without the client knowing.
"""

MAX_REFERENCE_PIXELS = 1 << 21
"""Largest size of a reference to decode."""


@dataclass(frozen=True, eq=False)
class Received:
    """A received reference."""

    frame: int
    order: int
    """Number of the reference in order of arrival, over all connections."""
    basis: int
    """Mark of the client's store that it assumes."""
    camera: Camera
    kind: ReferenceKind
    coded: F32 | None = None  # [h, w, 3] in [0, 1]; None for an empty reference
    knee: float = 0.1
    error: float = 0.0
    """Mean squared coding error of a picture, RGB in [0, 1]."""
    seq: int = 0
    reach: float = HOLDS
    """How far from its camera a difference holds, radians."""
    _for_correctors: list[Reference] = field(default_factory=list)

    @property
    def assumes(self) -> bool:
        """Whether it is valid for its basis only; a picture is compared with whatever the client holds."""
        return self.kind is not ReferenceKind.PICTURE

    def reference(self, own_error: float = math.nan) -> Reference:
        """The form for correctors, the same one for about the same ``own_error``: the mean squared error that the
        client's own splats are expected to have, RGB in [0, 1].
        """
        assert self.coded is not None, "a reference that says nothing corrects nothing"
        picture = self.kind is ReferenceKind.PICTURE
        error = doubted(self.error, own_error) if picture else 0.0
        if not self._for_correctors or self._for_correctors[0].error != error:
            self._for_correctors[:] = [Reference(self.coded, self.camera, picture, self.knee, error)]
        return self._for_correctors[0]

    @cached_property
    def picture(self) -> ReferencePicture | None:
        """The form for aligners; None for a difference."""
        if self.kind is not ReferenceKind.PICTURE or self.coded is None:
            return None
        return ReferencePicture(self.coded, self.camera, self.frame, self.seq)


class References:
    """Decodes the reference video and finds the reference of a frame. Decoding and reading may use two threads."""

    def __init__(self, near: float = DEFAULT_NEAR) -> None:
        self._decoder = H264Decoder(max_pixels=MAX_REFERENCE_PIXELS)
        self._near = near
        self._last_seq = self._order = 0
        self.last_decoded = 0
        """Sequence number of the last decoded picture; 0 before any."""
        self._received: dict[int, Received] = {}
        self._to_come: set[int] = set()  # frames of theirs that have not been reached
        self._frame = -1  # on display
        self._first: int | None = None  # that was displayed since the start or the last jump
        self._lock = threading.Lock()

    def add(self, message: ReferenceFrame, access_unit: memoryview, basis: int) -> bool:
        """Decode one reference, which assumes mark ``basis`` of the store. Returns whether the video is intact; if not,
        an IDR picture is needed.

        After a gap in the sequence all pictures up to the next IDR are wrong without an error, so they are discarded.
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
                message.frame,
                self._order,
                basis,
                camera,
                kind,
                coded,
                message.knee,
                message.error,
                message.seq,
                message.reach,
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

        Each round of a loop has its own references. A reference whose frame was displayed or skipped is no longer
        awaited, and it is dropped when the next round begins, for which it would be wrong.
        """
        with self._lock:
            coming = {f: self._received[f] for f in self._to_come}
            reached = {} if frame < self._frame else self._received
            self._frame, self._first = frame, frame if self._first is None else self._first
            self._to_come = {f for f in coming if 0 < (f - frame) % frames < frames / 2}
            self._received = {
                f: r
                for f, r in {**reached, **coming}.items()
                if f <= frame or f in self._to_come or (frame - f) % frames > LATEST * frames
            }

    @property
    def beginning(self) -> bool:
        """Whether the displayed frame is one of the first after a start or a jump (:data:`BEGINNING`)."""
        return self._first is not None and 0 <= self._frame - self._first < BEGINNING

    def newest(self, max_age: int) -> Received | None:
        """The reference of the displayed frame, or the newest of the ``max_age`` frames before it."""
        with self._lock:
            past = [f for f in self._received if f not in self._to_come and 0 <= self._frame - f <= max_age]
            return self._received[max(past)] if past else None

    def next_basis(self) -> int | None:
        """The mark assumed by the next received references, of frames after the displayed one. None if there are none,
        or if they assume no mark.
        """
        with self._lock:
            waiting = [self._received[f] for f in self._to_come]
            return min((r.basis for r in waiting if r.assumes), default=None)

    def restart(self) -> None:
        """Another server's video follows, numbered from 1; received references stay."""
        self._decoder.reset()
        self._last_seq = self.last_decoded = 0

    @property
    def count(self) -> int:
        """Number of received references, over all connections."""
        return self._order

    def reset(self, until: int | None = None) -> None:
        """Forget all references (the viewer jumped), or the first ``until`` received; the decoder continues."""
        with self._lock:
            self._first = self._first if until is not None else None
            kept = {f: r for f, r in self._received.items() if until is not None and r.order > until}
            self._received = kept
            self._to_come &= kept.keys()
