"""One picture of the page as a stream: H.264 for WebCodecs, JPEG frame by frame, or uncompressed 4:2:0.

The page sits on the same machine as a rule, and the processor is busy drawing: this coder is set up to cost little,
not to code small. It differs from the reference's coder (:mod:`cags_common.video`) in that it takes OpenCV's own colour
conversion (BT.601, 0.3 ms a picture where an exact BT.709 one takes 2 ms and more) and x264's cheapest preset. A page
on the same machine takes pictures as they are: for 0.7 MB a picture of 800x600 over loopback nothing is coded at all.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

import av
import cv2
import numpy as np
from av.codec.context import Flags, ThreadType
from av.video.codeccontext import VideoCodecContext
from av.video.frame import PictureType, VideoFrame
from av.video.reformatter import ColorPrimaries, ColorRange, Colorspace, ColorTrc
from numpy.typing import NDArray

from cags_common.video.h264 import is_idr

U8 = NDArray[np.uint8]

H264, JPEG, RAW = KINDS = "h264", "jpeg", "i420"
PRESET = "ultrafast"
FORMAT = "yuv420p"
X264 = "repeat-headers=1:keyint=infinite:scenecut=0:annexb=1"
"""Parameter sets in front of every key picture; key pictures only when they are asked for."""

_START_CODE_SPS = (b"\x00\x00\x01\x67", b"\x00\x00\x01\x27")


@dataclass(frozen=True, slots=True)
class Coded:
    """One coded picture. ``codec`` is a WebCodecs codec string, ``jpeg`` or ``i420``."""

    data: bytes
    codec: str
    key: bool
    width: int
    height: int


class PictureStream:
    """Codes one named picture for one page. A change of size starts the stream anew. Not thread-safe.

    ``kind`` is one of :data:`KINDS`.
    """

    def __init__(self, *, kind: str, fps: float, crf: float, jpeg_quality: int) -> None:
        self._kind, self._fps, self._crf, self._jpeg_quality = kind, fps, crf, jpeg_quality
        self._encoder: VideoCodecContext | None = None
        self._pts = 0
        self._size = (0, 0)
        self._codec = ""

    def encode(self, image: U8, *, key: bool = False) -> Coded:
        """Code one RGB image [H, W, 3] of even size; ``key`` asks for a picture that needs no earlier one."""
        height, width = image.shape[:2]
        if self._kind == JPEG:
            return self._jpeg(image)
        if self._kind == RAW:
            return Coded(planes_of(image).tobytes(), RAW, True, width, height)
        if self._encoder is None or self._size != (width, height):
            self._encoder, self._size, self._pts = _open(width, height, self._fps, self._crf), (width, height), 0
        data = self._code(self._encoder, image, key)
        idr = is_idr(data)
        if idr:
            self._codec = codec_string(data)
        return Coded(data, self._codec, idr, width, height)

    def _code(self, encoder: VideoCodecContext, image: U8, key: bool) -> bytes:
        frame = VideoFrame.from_ndarray(planes_of(image), format=FORMAT)
        frame.pts, frame.time_base = self._pts, encoder.time_base
        frame.pict_type = PictureType.I if key or self._pts == 0 else PictureType.NONE
        frame.colorspace, frame.color_range = int(Colorspace.SMPTE170M), int(ColorRange.MPEG)
        self._pts += 1
        packets = encoder.encode(frame)
        if len(packets) != 1:
            raise RuntimeError(f"x264 gave {len(packets)} packets for one picture; it must not delay")
        return bytes(packets[0])

    def _jpeg(self, image: U8) -> Coded:
        height, width = image.shape[:2]
        done, data = cv2.imencode(
            ".jpg", cv2.cvtColor(image, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, self._jpeg_quality]
        )
        if not done:
            raise RuntimeError(f"OpenCV could not code a picture of {width}x{height} as JPEG")
        return Coded(data.tobytes(), JPEG, True, width, height)


def planes_of(image: U8) -> U8:
    """Luma and both chromas of an RGB image [H, W, 3] of even size, as bytes one after another: [H * 3 / 2, W]."""
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2YUV_I420), dtype=np.uint8)


def _open(width: int, height: int, fps: float, crf: float) -> VideoCodecContext:
    context = av.CodecContext.create("libx264", "w")
    assert isinstance(context, VideoCodecContext)
    rate = Fraction(fps).limit_denominator(60_000)
    context.width, context.height, context.pix_fmt = width, height, FORMAT
    context.framerate, context.time_base = rate, 1 / rate
    context.colorspace, context.color_range = int(Colorspace.SMPTE170M), int(ColorRange.MPEG)
    context.color_primaries, context.color_trc = int(ColorPrimaries.BT709), int(ColorTrc.IEC61966_2_1)
    context.thread_type, context.thread_count = ThreadType.SLICE, 1
    context.flags |= Flags.low_delay
    options = {"preset": PRESET, "tune": "zerolatency", "crf": f"{crf:g}", "forced-idr": "1", "x264-params": X264}
    context.options = options
    context.open()
    return context


def codec_string(access_unit: bytes) -> str:
    """``avc1.PPCCLL`` of an access unit with a sequence parameter set: profile, constraints and level (RFC 6381)."""
    at = next((found for code in _START_CODE_SPS if (found := access_unit.find(code)) >= 0), -1)
    if at < 0 or at + 7 > len(access_unit):
        raise ValueError("the access unit carries no sequence parameter set")
    return "avc1." + access_unit[at + 4 : at + 7].hex()
