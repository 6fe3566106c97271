"""The ``cpu`` corrector: the native kernels of ``cags-kernels`` behind the correction seam."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import cags_kernels
from cags_common.correction.base import (
    Corrected,
    CorrectSettings,
    Placement,
    Reference,
    checked_depth,
    checked_own,
    checked_veto,
)
from cags_common.errors import ConfigError
from cags_common.geometry import F32, Camera
from cags_common.raster.base import RenderedView


@dataclass(frozen=True, eq=False)
class _Expanded:
    """The correction of a reference, prepared for sampling."""

    reference: Reference
    lack: NDArray[np.int16]  # [h + 2, w + 1, 4, 2]


class CpuCorrector:
    """The backend ``cpu`` with ``threads`` threads, whose number does not affect results.

    Pixels are within 1e-4 of the definition, unless a z-test depends on the last bits of a float. Raises
    :class:`ConfigError` if the native library is missing or ``threads`` is less than 1.
    """

    name = "cpu"

    def __init__(self, threads: int = 2) -> None:
        if not cags_kernels.native_available():
            reason = cags_kernels.why_unavailable()
            raise ConfigError(f"corrector 'cpu' cannot run: {reason}; install a C++ compiler, then ./kernels again")
        if threads < 1:
            raise ConfigError(f"threads = {threads} must be at least 1")
        self._threads = threads
        self._held: _Expanded | None = None

    def needs_own(self, reference: Reference) -> bool:
        """Whether a picture is new."""
        return reference.picture and (self._held is None or self._held.reference is not reference)

    def correct(
        self,
        view: RenderedView,
        camera: Camera,
        reference: Reference,
        own: F32 | None = None,
        settings: CorrectSettings | None = None,
        *,
        veto: F32 | None = None,
    ) -> Corrected:
        """See :class:`.base.Corrector`."""
        from cags_kernels.correct import AddParameters, DrawnView, add

        settings = settings or CorrectSettings()
        drawn = DrawnView(view.rgb, view.alpha, checked_depth(view, camera))
        veto = None if veto is None else checked_veto(veto, camera)
        placement = Placement(camera, reference.camera)
        how = AddParameters(
            placement.matrix,
            placement.cell_px,
            placement.stride,
            settings.depth_tolerance,
            settings.slope_cells,
            settings.border_px,
            settings.hole_alpha,
            self._threads,
        )
        return Corrected(*add(drawn, self._lack(reference, own), veto, how))

    def _lack(self, reference: Reference, own: F32 | None) -> NDArray[np.int16]:
        """The cached result for the reference, if it is still valid."""
        from cags_kernels.correct import compared, expanded

        held = self._held
        fresh = reference.picture and own is not None
        if held is None or held.reference is not reference or fresh:
            if reference.picture:
                if own is None:
                    raise ValueError(
                        "a reference that is a picture needs the client's render from the reference camera"
                    )
                made = compared(reference.coded, checked_own(own, reference), reference.error, self._threads)
            else:
                made = expanded(reference.coded, reference.knee, self._threads)
            self._held = held = _Expanded(reference, made)
        return held.lack
