"""A client's splats, its view, and the server's references for it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from cags_bench.align.settings import AlignBenchSettings
from cags_common import raster
from cags_common.bundle import BundleReader
from cags_common.bundle.player import BundlePlayer
from cags_common.correction import Reference, compand
from cags_common.geometry import F32, F64, Camera, Intrinsics, Pose, multiply_quaternions, quaternion_of_rotation_vector
from cags_common.poses import Focus, open_poses
from cags_common.raster.base import DepthKind, Footprint, RasterScene, RenderOptions
from cags_common.splats import Splats
from cags_common.video.colour import Chroma, rgb_of_ycbcr, ycbcr_of_rgb
from cags_common.video.h264 import H264Decoder, H264Encoder
from cags_server.fov import widened

REFERENCE_PX = (400, 300)
"""Default width and height of references."""

AT_US = 1_700_000
"""Time of the measured view in the walk."""

KNEE = 0.06
"""Knee of the compander, for differences at middle levels."""


@dataclass(frozen=True, eq=False)
class View:
    """A client's view, and both kinds of reference from a pose with an error."""

    splats: Splats
    """The client's splats."""
    held: RasterScene
    truth: RasterScene
    camera: Camera
    difference: Reference
    picture: Reference
    own_options: RenderOptions
    """Options with which the client draws its own splats from the reference's camera."""

    def own(self) -> F32:
        """View of the client's splats from the reference's camera [h, w, 3]."""
        return self.held.render(self.picture.camera, self.own_options).rgb


def view_of(reader: BundleReader, settings: AlignBenchSettings, size: tuple[int, int]) -> View:
    """The client's view of the bundle's first frame."""
    m, rasteriser = reader.manifest, raster.create(settings.device)
    truth = rasteriser.load(reader.source(0).splats)
    splats = BundlePlayer(reader, round(settings.lod * (m.lods - 1))).frame(0).splats
    held = rasteriser.load(splats)
    walk = open_poses(settings.poses, Focus(m.focus_centre, m.focus_radius, m.up))
    fov_y = 2 * math.atan(math.tan(math.radians(settings.fov) / 2) * size[1] / size[0])
    camera = Camera(Intrinsics.of_fov(*size, math.radians(settings.fov), fov_y), walk.pose_at(AT_US), m.near)
    reference_camera = _reference_camera(camera, settings)
    footprint = Footprint.of(camera.intrinsics, reference_camera.intrinsics)
    options = RenderOptions(footprint=footprint, depth=DepthKind.NONE, threads=settings.threads)
    seen, own = (scene.render(reference_camera, options).rgb.clip(0, 1) for scene in (truth, held))
    lack = compand(seen - own, KNEE).astype(np.float32)
    difference, picture = (_through_codec(coded, m.fps, settings.crf) for coded in (lack, seen))
    return View(
        splats,
        held,
        truth,
        camera,
        Reference(difference, reference_camera, knee=KNEE),
        Reference(picture, reference_camera, picture=True),
        options,
    )


def _reference_camera(camera: Camera, settings: AlignBenchSettings) -> Camera:
    random = np.random.default_rng(settings.seed)
    axis, step = (v / np.linalg.norm(v) for v in random.standard_normal((2, 3)))
    pose = moved(camera.pose, math.radians(settings.error_deg), settings.error_cm / 100, axis, step)
    return Camera(widened(camera.intrinsics, (settings.margin,) * 2, *REFERENCE_PX), pose, camera.near)


def moved(pose: Pose, angle_rad: float, distance: float, axis: F64, step: F64) -> Pose:
    """``pose`` turned about the unit vector ``axis`` and moved by ``distance`` along the unit vector ``step``."""
    ax, ay, az = (float(c) * angle_rad for c in axis)
    x, y, z = (p + distance * float(s) for p, s in zip(pose.position, step, strict=True))
    return Pose((x, y, z), multiply_quaternions(pose.rotation, quaternion_of_rotation_vector((ax, ay, az))))


def _through_codec(picture: F32, fps: float, crf: float) -> F32:
    """The first picture [h, w, 3] of a video after coding and decoding."""
    encoder = H264Encoder(picture.shape[1], picture.shape[0], fps, crf=crf, chroma=Chroma.FULL)
    decoded = H264Decoder().decode_ycbcr(encoder.encode_ycbcr(ycbcr_of_rgb(picture), idr=True))
    assert decoded is not None, "the first picture of a video is an IDR picture"
    return rgb_of_ycbcr(decoded)


def fresh(reference: Reference) -> Reference:
    """A copy of ``reference`` that no corrector has cached."""
    return replace(reference)
