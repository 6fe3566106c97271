"""Alignment by rotation alone: the reference lies on a sphere at infinity (the baseline ``reference-only``).

What a remote-rendering client without geometry can do about a wrong prediction: the homography
``K_r R_r^-1 R_l K_l^-1`` corrects where it looks, and not where it stands (time warp; van Waveren 2016). No depth is
read, so a client that holds no splats sees the whole picture.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cags_client.frame.align.base import Aligned, AlignSettings
from cags_client.frame.align.fast import FastAligner
from cags_client.store.picture import ReferencePicture
from cags_common.geometry import F32, Camera, Pose


class RotationAligner:
    """Turns the reference to the client's view; nothing counts as occluded."""

    name = "rotation"

    def __init__(self, settings: AlignSettings | None = None) -> None:
        self._inner = FastAligner(settings)

    def align(
        self,
        reference: ReferencePicture,
        depth: F32,
        camera: Camera,
        *,
        occlusion: bool = True,
        colours: bool = False,
    ) -> Aligned:
        """See :class:`cags_client.frame.align.base.Aligner`; of ``depth`` only the size counts."""
        del occlusion  # as if from one place: nothing is hidden
        pose = Pose(camera.pose.position, reference.camera.pose.rotation)
        there = replace(reference, camera=reference.camera.at(pose))
        return self._inner.align(there, np.ones_like(depth), camera, occlusion=False, colours=colours)
