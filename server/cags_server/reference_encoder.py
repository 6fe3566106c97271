"""The encoder of one client's references: of constant quality, or at a share of what the link carries."""

from __future__ import annotations

from cags_common.geometry import F32, Intrinsics
from cags_common.video.colour import Chroma, ycbcr_of_rgb
from cags_common.video.h264 import H264Decoder, H264Encoder
from cags_common.video.noise import CodingNoise, coding_noise_of_ycbcr
from cags_server.settings import ServerSettings

RATE_STEP = 1.25
"""The video is begun anew (with a picture that needs no other) when its rate is off by more than this factor."""

LEAST_BPS = 50_000

BUFFER_S = 0.1
"""Over which a followed rate is kept: more would arrive in bursts that come too late."""


class ReferenceEncoder:
    """Encodes the references of one client. ``client`` is its display: the size of references that ask for it."""

    def __init__(self, settings: ServerSettings, client: Intrinsics, fps: float) -> None:
        self._settings, self._fps = settings, fps
        full = settings.reference_full_size
        self.width_px = client.width_px // 2 * 2 if full else settings.reference_width
        self.height_px = client.height_px // 2 * 2 if full else settings.reference_height
        self._bps = settings.reference_kbps * 1000 if settings.reference_kbps else None
        self._encoder, self._decoder = self._opened(), H264Decoder()

    def follow(self, link_bps: float) -> None:
        """The link carries so much now. Only a video that takes a share of the link changes its rate."""
        if self._settings.reference_share is None:
            return
        wanted = max(int(link_bps * self._settings.reference_share), LEAST_BPS)
        if self._bps is None or not self._bps / RATE_STEP <= wanted <= self._bps * RATE_STEP:
            self._bps = wanted
            self._encoder, self._decoder = self._opened(), H264Decoder()

    def encode(self, rgb: F32, *, idr: bool = False) -> tuple[bytes, CodingNoise | None]:
        """The access unit of a picture (:meth:`~cags_common.video.h264.H264Encoder.encode`), and what coding did to it.

        None where the client has nothing to compare it with. Every picture is decoded again: the decoder follows the
        client's. All of it works on YCbCr codes, which spares four conversions of the picture.
        """
        ycbcr = ycbcr_of_rgb(rgb)
        unit = self._encoder.encode_ycbcr(ycbcr, idr=idr)
        if self._settings.reference_full_size:
            return unit, None
        decoded = self._decoder.decode_ycbcr(unit)
        return unit, None if decoded is None else coding_noise_of_ycbcr(ycbcr, decoded)

    def _opened(self) -> H264Encoder:
        s = self._settings
        return H264Encoder(
            self.width_px,
            self.height_px,
            self._fps,
            crf=s.reference_crf,
            chroma=Chroma(s.reference_chroma),
            max_bps=self._bps,
            buffer_s=0.5 if s.reference_share is None else BUFFER_S,
        )
