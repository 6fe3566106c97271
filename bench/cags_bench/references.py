"""Reference pictures outside of any session: from a pose that is off, and through the codec."""

from __future__ import annotations

from cags_client.align import ReferencePicture
from cags_common.geometry import F32, F64, Camera, Pose, multiply_quaternions, quaternion_of_rotation_vector
from cags_common.video.colour import Chroma
from cags_common.video.h264 import H264Decoder, H264Encoder
from cags_common.video.noise import coding_noise

REFERENCE_PX = (400, 300)
"""Width and height of references, as shipped."""


def coded_reference(rgb: F32, camera: Camera, *, fps: float, crf: float) -> tuple[ReferencePicture, int]:
    """What a client decodes of ``rgb`` [h, w, 3] in [0, 1], seen by ``camera``, and its size in bytes.

    The first picture of a video, with its coding noise.
    """
    encoder = H264Encoder(camera.width_px, camera.height_px, fps, crf=crf, chroma=Chroma.FULL)
    unit = encoder.encode(rgb, idr=True)
    decoded = H264Decoder().decode(unit)
    assert decoded is not None, "the first picture of a video is an IDR picture"
    return ReferencePicture(decoded, camera, 0, noise=coding_noise(rgb, decoded)), len(unit)


def moved(pose: Pose, angle_rad: float, distance: float, axis: F64, step: F64) -> Pose:
    """``pose`` turned about the unit vector ``axis`` and moved by ``distance`` along the unit vector ``step``."""
    ax, ay, az = (float(c) * angle_rad for c in axis)
    x, y, z = (p + distance * float(s) for p, s in zip(pose.position, step, strict=True))
    return Pose((x, y, z), multiply_quaternions(pose.rotation, quaternion_of_rotation_vector((ax, ay, az))))
