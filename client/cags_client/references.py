"""Decoded reference pictures, matched to the frames that are shown."""

from __future__ import annotations

import threading

from cags_client.align import ReferencePicture
from cags_common.errors import DecodeError
from cags_common.geometry import DEFAULT_NEAR, Camera
from cags_common.video.h264 import H264Decoder
from cags_common.video.noise import CodingNoise
from cags_protocol.messages import ReferenceFrame

KEPT = 24
"""References kept: those sent ahead of display and the last few shown."""

MAX_REFERENCE_PIXELS = 1 << 21
"""Largest reference that is decoded."""


class References:
    """Decodes the reference video and hands out the picture for a frame. Decoding and reading may be in two threads."""

    def __init__(self, near: float = DEFAULT_NEAR) -> None:
        self._decoder = H264Decoder(max_pixels=MAX_REFERENCE_PIXELS)
        self._near = near
        self._last_seq = 0
        self.last_decoded = 0
        """Sequence number of the last picture that was decoded; 0 before any."""
        self._pictures: dict[int, ReferencePicture] = {}
        self._lock = threading.Lock()

    def add(self, message: ReferenceFrame, access_unit: memoryview) -> bool:
        """Decode one picture. Returns whether the video is whole: if not, an IDR picture is needed.

        A gap in the sequence makes every picture up to the next IDR wrong without an error, so they are not shown.
        Raises :class:`DecodeError`.
        """
        if message.seq <= self._last_seq and not message.idr:
            return True  # late: the decoder is past it
        if message.seq != self._last_seq + 1 and not message.idr:
            self._decoder.reset()
        self._last_seq = message.seq
        rgb = self._decoder.decode(access_unit)
        if rgb is None:
            return False
        i = message.intrinsics
        if rgb.shape[:2] != (i.height_px, i.width_px):
            raise DecodeError(
                f"reference {message.seq} is {rgb.shape[1]}x{rgb.shape[0]}, said {i.width_px}x{i.height_px}"
            )
        self.last_decoded = message.seq
        noise = CodingNoise.of_packed(message.noise)
        picture = ReferencePicture(rgb, Camera(i, message.pose, self._near), message.frame, message.seq, noise)
        with self._lock:
            self._pictures.pop(message.frame, None)
            self._pictures[message.frame] = picture
            while len(self._pictures) > KEPT:
                del self._pictures[next(iter(self._pictures))]
        return True

    def newest(self, frame: int, max_age: int) -> ReferencePicture | None:
        """The picture of ``frame``, or the newest of the ``max_age`` frames before it.

        Never one of a frame to come: what the client will hold of it then is not known, and so not what is wrong in it.
        """
        with self._lock:
            past = [f for f in self._pictures if 0 <= frame - f <= max_age]
            return self._pictures[max(past)] if past else None

    def restart(self) -> None:
        """Another server's video follows, numbered from 1; the pictures stay."""
        self._decoder.reset()
        self._last_seq = self.last_decoded = 0

    def reset(self) -> None:
        """Forget every picture (the viewer jumped); the decoder goes on."""
        with self._lock:
            self._pictures.clear()
