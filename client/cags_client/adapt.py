"""Colour adaptation in splat space: corrections that stay with the splats from frame to frame.

One step a frame of SIRT (simultaneous iterative reconstruction: Gilbert 1972): the difference between the reference and
the client's own splats, seen from the reference's pose, is carried back onto the splats that made the picture,

    delta_i += sum_p w_ip e_p / (sum_p w_ip + damping),

with compositing weights w and the difference e divided by the pixel's alpha. Nothing is warped, so occlusion and
transparency come out right, and many references add up. Only what stands above the reference's own noise is taken
(:func:`~cags_client.restore.affine.corrected_there`), else the splats would learn H.264's errors.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cags_client.align import ReferencePicture
from cags_client.restore.affine import AffineSettings, corrected_there
from cags_common.geometry import F32
from cags_common.raster.base import RasterScene, RenderedView, RenderOptions
from cags_common.splats import SH_C0, Splats

DAMPING_PX = 0.02
"""Weight, in pixels, that a splat must have for half of its step."""

LEAST_WEIGHT_PX = 0.01
"""Splats of less weight in the reference are left as they are."""

MAX_CHANGE = 0.35
"""Bound on how far a colour may go, in [0, 1] of display range."""

LEAST_ALPHA = 0.05
LEAST_ERROR = 1e-4
"""Largest correction of a pixel below which a step is not worth its work."""


@dataclass(frozen=True, eq=False)
class AdapterStep:
    """Changes of colour [M, 3], in display range, of the splats at ``rows`` [M]."""

    rows: NDArray[np.intp]
    change: NDArray[np.float32]


class SirtAdapter:
    """Colour corrections of one group of frames. Not thread-safe."""

    def __init__(self, capacity: int) -> None:
        self._delta = np.zeros((capacity, 3), np.float32)
        self._settings = AffineSettings()

    def forget(self, rows: NDArray[np.intp]) -> None:
        """These splats have changed: their corrections belonged to older colours."""
        self._delta[rows] = 0

    def adapt(
        self,
        scene: RasterScene,
        splats: Splats,
        reference: ReferencePicture,
        own: RenderedView,
        options: RenderOptions,
    ) -> int:
        """One step. ``splats`` are the uncorrected ones, ``own`` the scene as it is now from the reference's camera.

        Returns how many splats changed.
        """
        return self.apply(scene, splats, self.step(scene, reference, own, options))

    def step(
        self, scene: RasterScene, reference: ReferencePicture, own: RenderedView, options: RenderOptions
    ) -> AdapterStep:
        """What :meth:`apply` would change. Reads the scene beside renders of it, but not beside its updates."""
        shown = np.clip(own.rgb, 0.0, 1.0)
        change = corrected_there(shown, reference, self._settings) - shown
        error = scaled(change, np.reciprocal(np.maximum(own.alpha, np.float32(LEAST_ALPHA))))
        if not np.abs(error).max() > LEAST_ERROR:
            return AdapterStep(np.zeros(0, np.intp), np.zeros((0, 3), np.float32))
        back = scene.back_project(reference.camera, error, options)
        rows = np.nonzero(back.weight > LEAST_WEIGHT_PX)[0]
        residual = back.weighted_residual.take(rows, axis=0)  # take: a quarter of what indexing costs
        return AdapterStep(rows, scaled(residual, np.reciprocal(back.weight.take(rows) + np.float32(DAMPING_PX))))

    def apply(self, scene: RasterScene, splats: Splats, step: AdapterStep) -> int:
        """Correct the scene's colours by a step. Returns how many splats changed."""
        rows = step.rows
        if len(rows):
            delta = self._delta.take(rows, axis=0)
            delta += step.change
            self._delta[rows] = np.clip(delta, -MAX_CHANGE, MAX_CHANGE, out=delta)
            scene.recolour(rows, self.corrected(splats.sh0.take(rows, axis=0), rows))
        return len(rows)

    def corrected(self, sh0: F32, rows: NDArray[np.intp]) -> F32:
        """Base colours ``sh0`` [M, 3] of the splats at ``rows`` [M] with their corrections."""
        return sh0 + self._delta.take(rows, axis=0) / np.float32(SH_C0)


def scaled(colours: F32, factor: F32) -> F32:
    """``colours`` [..., 3] times ``factor`` [...], by channel: along so short an axis it is three times slower."""
    out = np.empty_like(colours)
    for channel in range(3):
        np.multiply(colours[..., channel], factor, out=out[..., channel])
    return out
