"""Alignment by the native kernels."""

from __future__ import annotations

import cags_kernels
from cags_client.align.base import Aligned, AlignSettings, ReferencePicture, Reprojection
from cags_common.errors import ConfigError
from cags_common.geometry import F32, Camera

NOTHING_HIDDEN = 1e30
"""A depth tolerance that no pixel lies behind; the pass that looks for the nearest one is then cut short too."""


class CpuAligner:
    """The same result as :class:`cags_client.align.reference.ReferenceAligner` in float32, a frame in milliseconds.

    Raises :class:`ConfigError` where the native library is missing.
    """

    name = "cpu"

    def __init__(self, settings: AlignSettings | None = None) -> None:
        if not cags_kernels.native_available():
            raise ConfigError(f"aligner 'cpu' cannot run: {cags_kernels.why_unavailable()}; use 'fast'")
        self._settings = settings or AlignSettings()

    def align(
        self,
        reference: ReferencePicture,
        depth: F32,
        camera: Camera,
        *,
        occlusion: bool = True,
        colours: bool = False,
    ) -> Aligned:
        """See :class:`cags_client.align.base.Aligner`."""
        from cags_kernels import align as kernels

        geometry = Reprojection(depth, camera, reference.camera)
        s = self._settings
        parameters = kernels.AlignParameters(
            cell_px=geometry.cell_px,
            stride=geometry.stride if occlusion else max(depth.shape),
            depth_tolerance=s.depth_tolerance if occlusion else NOTHING_HIDDEN,
            slope_cells=s.slope_cells,
            border_px=s.border_px,
            erosion_radius=s.erosion_radius_px,
            erosion_iterations=s.erosion_iterations,
            threads=s.threads,
        )
        view = kernels.Reprojection(depth, *geometry.matrix)
        image = kernels.align(reference.rgb, view, parameters, colours=colours)

        def paint() -> F32:
            whole = image if image.rgb is not None else kernels.align(reference.rgb, view, parameters, colours=True)
            assert whole.rgb is not None
            return whole.rgb

        return Aligned(paint, image.confidence, image.occluded, geometry)
