"""No alignment: the reference as if it had been seen from the client's pose (the paper's ablation "w/o PRPA")."""

from __future__ import annotations

from dataclasses import replace

from cags_client.frame.align.base import Aligned, AlignSettings
from cags_client.frame.align.fast import FastAligner
from cags_client.store.picture import ReferencePicture
from cags_common.geometry import F32, Camera


class UnalignedAligner:
    """Resamples the reference by the two fields of view alone; nothing counts as occluded."""

    name = "unaligned"

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
        """See :class:`cags_client.frame.align.base.Aligner`; ``depth`` only tells void pixels."""
        del occlusion  # as if from one place: nothing is hidden
        there = replace(reference, camera=reference.camera.at(camera.pose))
        return self._inner.align(there, depth, camera, occlusion=False, colours=colours)
