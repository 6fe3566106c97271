"""Reference pictures outside of any session: from a pose that is off, and through the codec."""

from __future__ import annotations

import re

from cags_client.align import ReferencePicture
from cags_common.errors import ConfigError
from cags_common.geometry import F32, F64, Camera, Pose, multiply_quaternions, quaternion_of_rotation_vector
from cags_common.raster.base import RasterScene, RenderOptions
from cags_common.video.colour import Chroma
from cags_common.video.h264 import H264Decoder, H264Encoder
from cags_common.video.noise import coding_noise

REFERENCE_PX = (400, 300)
"""Width and height of references, as shipped."""


def coded_reference(
    source: RasterScene, camera: Camera, options: RenderOptions, *, fps: float, crf: float
) -> ReferencePicture:
    """What a client decodes of ``source`` seen by ``camera``: the first picture of a video, with its coding noise."""
    rgb: F32 = source.render(camera, options).rgb.clip(0, 1)
    encoder = H264Encoder(camera.width_px, camera.height_px, fps, crf=crf, chroma=Chroma.FULL)
    decoded = H264Decoder().decode(encoder.encode(rgb, idr=True))
    assert decoded is not None, "the first picture of a video is an IDR picture"
    return ReferencePicture(decoded, camera, 0, noise=coding_noise(rgb, decoded))


def moved(pose: Pose, angle_rad: float, distance: float, axis: F64, step: F64) -> Pose:
    """``pose`` turned about the unit vector ``axis`` and moved by ``distance`` along the unit vector ``step``."""
    ax, ay, az = (float(c) * angle_rad for c in axis)
    x, y, z = (p + distance * float(s) for p, s in zip(pose.position, step, strict=True))
    return Pose((x, y, z), multiply_quaternions(pose.rotation, quaternion_of_rotation_vector((ax, ay, az))))


def size_of(text: str) -> tuple[int, int]:
    """Width and height of ``WIDTHxHEIGHT``. Raises :class:`ConfigError`."""
    match = re.fullmatch(r"(\d{1,5})x(\d{1,5})", text)
    if match is None:
        raise ConfigError(f"size {text!r} must be WIDTHxHEIGHT, such as 800x600")
    return int(match[1]), int(match[2])
