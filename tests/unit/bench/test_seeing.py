"""A frame outside of any session is the client's own."""

from __future__ import annotations

import numpy as np

from cags_bench.seeing import available_restorers, see
from cags_client.frame import restore
from cags_client.frame.align import ReferencePicture
from cags_common import raster
from cags_common.correction import Reference
from cags_common.geometry import Camera, Intrinsics, Pose
from cags_common.raster.base import Footprint, RenderOptions
from support.codec_scenes import cloud, with_changes

CAMERA = Camera(Intrinsics(64, 48, 60.0, 60.0, 32.0, 24.0), Pose.identity())
SMALL = Camera(Intrinsics(32, 24, 30.0, 30.0, 16.0, 12.0), Pose.identity())


def scenes():
    true = cloud(300, 3)
    true = with_changes(true, means=0.4 * true.means + np.float32([0, 0, 4]))
    held = with_changes(true, sh0=true.sh0 + np.float32(0.5))
    return [raster.create("auto").load(splats) for splats in (true, held)]


def test_a_picture_corrects_what_the_client_draws():
    true, held = scenes()
    footprint = Footprint.of(CAMERA.intrinsics, SMALL.intrinsics)
    picture = true.render(SMALL, RenderOptions(footprint=footprint)).rgb.clip(0, 1)
    truth = true.render(CAMERA, RenderOptions()).rgb.clip(0, 1)
    seen = see(held, CAMERA)
    corrected = seen.corrected(Reference(picture, SMALL, picture=True))
    before, after = (float(np.square(rgb - truth).mean()) for rgb in (seen.distorted, corrected.rgb))
    assert after < 0.3 * before
    restored = seen.restored(ReferencePicture(picture, SMALL, 0), restore.create("reference"), 0.0)
    assert restored.shape == truth.shape


def test_restorers_that_are_listed_can_be_made():
    names = available_restorers()
    assert "reference" in names
    for name in names:
        restore.create(name)
