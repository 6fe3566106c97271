"""H.264 of the small reference images: one access unit in, one picture out, no delay (libx264 and FFmpeg through PyAV).

The encoder is set up for a live stream over a link that may lose or drop pictures: no look-ahead, no B-pictures, one
slice thread (so that equal input gives equal bytes on every machine), parameter sets in front of every IDR (so that a
decoder can start at any of them), Annex B byte stream, and colours tagged as :mod:`cags_common.video.colour` converts
them.
"""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from typing import Any

import av
import numpy as np
from av.codec.context import Flags, ThreadType
from av.error import FFmpegError
from av.video.codeccontext import VideoCodecContext
from av.video.frame import PictureType, VideoFrame
from av.video.reformatter import ColorPrimaries, ColorRange, Colorspace, ColorTrc
from numpy.typing import NDArray

from cags_common.errors import DecodeError
from cags_common.geometry import F32
from cags_common.video.colour import Chroma, planes_of_ycbcr, rgb_of_ycbcr, ycbcr_of_planes, ycbcr_of_rgb

MAX_PIXELS = 4096 * 2304
"""Largest picture that a decoder allocates for (H.264 level 5.1); a stream that claims more is refused."""

MAX_ACCESS_UNIT_BYTES = 8 << 20
"""Largest access unit that a decoder looks at."""

EXACT = "subme=4:trellis=1:ref=4"
"""What the preset spares that pays here. Receivers compute with the pictures: closeness to the original counts, not the
look of texture (``tune=psnr``). Rendered pictures hold no camera noise, so that motion found to a quarter of a pixel in
several earlier pictures predicts them well. Walks through four scenes, 400x300, 4:4:4, equal bytes: 2.9 to 4.0 dB more
in predicted pictures, 1.3 to 1.7 in key pictures, than the preset with the usual tuning; 4 ms instead of 3."""

CAREFUL, LIGHT = ("veryfast", EXACT), ("superfast", "ref=1")
"""Preset and exceptions from it. A light encoder takes half the time, and a third more bytes for the same picture."""

_NAL_SLICE, _NAL_IDR, _NAL_SPS = 1, 5, 7
_NAL_TYPE_MASK = 0x1F
_START_CODE = b"\x00\x00\x01"


class H264Encoder:
    """A live encoder of RGB images of one size.

    ``crf`` is x264's constant quality, 0 (lossless) to 51; lower is better and larger. ``max_bps``, when given, caps
    the rate over ``buffer_s`` seconds. ``light`` spares processor time and costs bytes. Not thread-safe; calls may come
    from different threads one after another.
    Raises ``ValueError`` for a size that the chosen chroma cannot hold, or settings out of range.
    """

    def __init__(
        self,
        width: int,
        height: int,
        fps: float,
        *,
        crf: float = 20.0,
        light: bool = False,
        chroma: Chroma = Chroma.HALF,
        max_bps: int | None = None,
        buffer_s: float = 0.5,
    ) -> None:
        if width < 2 or height < 2 or width * height > MAX_PIXELS:
            raise ValueError(f"picture size {width}x{height} must be 2x2 to {MAX_PIXELS} pixels")
        if chroma is Chroma.HALF and (width % 2 or height % 2):
            raise ValueError(f"picture size {width}x{height} must be even for 4:2:0; use full chroma or an even size")
        if not 0 <= crf <= 51:
            raise ValueError(f"crf = {crf} must lie in [0, 51]")
        self._shape = (height, width)
        self._chroma = chroma
        self._pts = 0
        preset, exceptions = LIGHT if light else CAREFUL
        options = {"crf": f"{crf:g}", "preset": preset, "tune": "zerolatency,psnr", "forced-idr": "1"}
        options["x264-params"] = f"repeat-headers=1:keyint=infinite:scenecut=0:annexb=1:{exceptions}"
        if max_bps is not None:
            options["maxrate"], options["bufsize"] = str(max_bps), str(max(1, int(max_bps * buffer_s)))
        self._context = _open_encoder(width, height, fps, chroma, options)

    def encode(self, rgb: NDArray[Any], *, idr: bool = False) -> bytes:
        """Encode one image [H, W, 3], float in [0, 1] or uint8, to one access unit; the first one is always an IDR.

        ``idr`` asks for a picture that needs no earlier one.
        """
        if rgb.shape != (*self._shape, 3):
            raise ValueError(f"image has shape {rgb.shape}, this encoder takes {(*self._shape, 3)}")
        return self.encode_ycbcr(ycbcr_of_rgb(rgb), idr=idr)

    def encode_ycbcr(self, ycbcr: F32, *, idr: bool = False) -> bytes:
        """As :meth:`encode`, of an image that :func:`~cags_common.video.colour.ycbcr_of_rgb` has converted."""
        frame = VideoFrame.from_ndarray(planes_of_ycbcr(ycbcr, self._chroma), format=self._chroma.value)
        frame.pts = self._pts
        frame.time_base = self._context.time_base
        frame.pict_type = PictureType.I if idr or self._pts == 0 else PictureType.NONE
        frame.colorspace, frame.color_range = int(Colorspace.ITU709), int(ColorRange.MPEG)
        self._pts += 1
        packets = self._context.encode(frame)
        if len(packets) != 1:
            raise RuntimeError(f"x264 gave {len(packets)} packets for one picture; it must not delay")
        return bytes(packets[0])


def _open_encoder(width: int, height: int, fps: float, chroma: Chroma, options: dict[str, str]) -> VideoCodecContext:
    context = av.CodecContext.create("libx264", "w")
    assert isinstance(context, VideoCodecContext)
    rate = Fraction(fps).limit_denominator(1001 * 60)
    context.width, context.height, context.pix_fmt = width, height, chroma.value
    context.framerate, context.time_base = rate, 1 / rate
    context.colorspace, context.color_range = int(Colorspace.ITU709), int(ColorRange.MPEG)
    context.color_primaries, context.color_trc = int(ColorPrimaries.BT709), int(ColorTrc.IEC61966_2_1)
    context.thread_type, context.thread_count = ThreadType.SLICE, 1
    context.flags |= Flags.low_delay
    context.options = options
    context.open()
    return context


class H264Decoder:
    """A live decoder: each access unit gives its picture at once.

    It waits for an IDR: access units before the first one, or after :meth:`reset`, give None. A missing picture cannot
    be seen here (the codec conceals it); the caller watches sequence numbers and calls :meth:`reset`.
    """

    def __init__(self, *, max_pixels: int = MAX_PIXELS) -> None:
        self._max_pixels = max_pixels
        self._context = _open_decoder(max_pixels)
        self._started = False

    def decode(self, access_unit: bytes | bytearray | memoryview) -> F32 | None:
        """The picture [H, W, 3] float32 in [0, 1] of one access unit, or None while no IDR has come.

        Raises :class:`DecodeError` for anything that is not one whole picture; the decoder then waits for the next IDR.
        """
        ycbcr = self.decode_ycbcr(access_unit)
        return None if ycbcr is None else rgb_of_ycbcr(ycbcr)

    def decode_ycbcr(self, access_unit: bytes | bytearray | memoryview) -> F32 | None:
        """As :meth:`decode`, in YCbCr codes."""
        data = bytes(access_unit)
        if not 0 < len(data) <= MAX_ACCESS_UNIT_BYTES:
            self.reset()
            raise DecodeError(f"H.264 access unit of {len(data)} bytes must hold 1 to {MAX_ACCESS_UNIT_BYTES}")
        kinds = set(nal_types(data))
        if not kinds & {_NAL_SLICE, _NAL_IDR}:
            self.reset()
            raise DecodeError(f"H.264 access unit of {len(data)} bytes holds no picture")
        if not self._started and not {_NAL_IDR, _NAL_SPS} <= kinds:
            return None
        try:
            frames = self._context.decode(av.Packet(data))
            image = _image_of(frames, len(data))
        except (FFmpegError, DecodeError) as error:
            self.reset()
            raise error if isinstance(error, DecodeError) else _undecodable(len(data), str(error)) from error
        self._started = True
        return image

    def reset(self) -> None:
        """Forget every picture and wait for the next IDR."""
        self._context = _open_decoder(self._max_pixels)
        self._started = False


def _open_decoder(max_pixels: int) -> VideoCodecContext:
    context = av.CodecContext.create("h264", "r")
    assert isinstance(context, VideoCodecContext)
    context.thread_type, context.thread_count = ThreadType.SLICE, 1
    context.flags |= Flags.low_delay
    context.options = {"max_pixels": str(max_pixels), "err_detect": "explode"}
    context.open()
    return context


def _image_of(frames: list[VideoFrame], size: int) -> F32:
    if len(frames) != 1:
        raise _undecodable(size, f"{len(frames)} pictures instead of one")
    frame = frames[0]
    if frame.is_corrupt:
        raise _undecodable(size, "the picture is damaged")
    if frame.format.name not in (Chroma.HALF.value, Chroma.FULL.value):
        raise _undecodable(size, f"pixel format {frame.format.name} is not one that this program sends")
    planes = np.ascontiguousarray(frame.to_ndarray(), dtype=np.uint8)
    return ycbcr_of_planes(planes, Chroma(frame.format.name))


def _undecodable(size: int, reason: str) -> DecodeError:
    return DecodeError(f"H.264 access unit of {size} bytes does not decode ({reason}); wait for the next IDR")


def nal_types(access_unit: bytes) -> Iterator[int]:
    """Types of the NAL units of an Annex B byte stream (ITU-T H.264, table 7-1)."""
    at = access_unit.find(_START_CODE)
    while at >= 0 and at + 3 < len(access_unit):
        yield access_unit[at + 3] & _NAL_TYPE_MASK
        at = access_unit.find(_START_CODE, at + 3)


def is_idr(access_unit: bytes) -> bool:
    """Whether a decoder can start at this access unit."""
    return _NAL_IDR in nal_types(access_unit)
