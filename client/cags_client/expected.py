"""What may be wrong in the client's own view of a reference, by the LoDs that its splats are held at.

In a pixel that is sum_i w_i e_i over its splats, with w the compositing weights and e the error that the encoder
measured for each LoD (:attr:`~cags_common.bundle.Manifest.lod_gains_db`): a bound that errors of splats side by side,
which share a codebook, come near to. Missing splats, and such that have moved on, are not in it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cags_client.carry import OnDisplay
from cags_client.restore import RestoreInput
from cags_common.geometry import F32, Camera
from cags_common.raster.base import DepthKind, Rasteriser, RenderOptions
from cags_common.splats import SH_C0

LEAST_ERROR_DB = -200.0


@dataclass(frozen=True, eq=False)
class _Drawn:
    key: tuple[Camera, int, RenderOptions]
    errors: F32 | None


class Veils:
    """Tells restorers what is known of veils. Where nothing veils anything, as in most scenes, that costs nothing."""

    def __init__(self, rasteriser: Rasteriser, gains_db: Sequence[float]) -> None:
        """``gains_db`` are what each LoD gains over the one below; with none nothing is known."""
        self._rasteriser = rasteriser
        errors_db = np.clip(-np.cumsum([0.0, *gains_db]), LEAST_ERROR_DB, 0.0)
        self._of_lod = np.power(10.0, errors_db / 20).astype(np.float32)
        self._drawn: _Drawn | None = None

    def watched(self, inputs: RestoreInput, held: OnDisplay, options: RenderOptions) -> RestoreInput:
        """``inputs`` with what may be wrong in their own view, which was drawn with ``options``, where that matters."""
        if inputs.own is None or not inputs.veil:
            return inputs
        return replace(inputs, expected=self.expected(inputs.reference.camera, held, options))

    def expected(self, camera: Camera, held: OnDisplay, options: RenderOptions) -> F32 | None:
        """[h, w] as a share of the lowest LoD's error; None where all is of one LoD, and nothing is to be told apart.

        From a reference's ``camera``, drawn once for each and for each state of the scene; ``options`` are those of
        the own view.
        """
        key = (camera, held.changes, options)
        if self._drawn is None or self._drawn.key != key:
            self._drawn = _Drawn(key, self._draw(camera, held, options))
        return self._drawn.errors

    def _draw(self, camera: Camera, held: OnDisplay, options: RenderOptions) -> F32 | None:
        shown, splats = held.store.shown, held.store.splats
        rows = np.nonzero(shown.owner >= 0)[0]
        lods = shown.lods()[shown.owner[rows]].astype(np.intp)
        if len(self._of_lod) == 1 or not len(rows) or lods.min() == lods.max():
            return None
        errors = self._of_lod.take(lods)
        grey = np.repeat((errors - np.float32(0.5))[:, None] / np.float32(SH_C0), 3, axis=1)
        some = splats.take(rows)
        scene = self._rasteriser.load(replace(some, sh0=grey, sh_rest=some.sh_rest[:, :0]))
        plain = replace(options, max_sh_degree=0, depth=DepthKind.NONE, contribution=False)
        return np.ascontiguousarray(scene.render(camera, plain).rgb[..., 0])
