"""The client's last step behind one seam: what is lacking, sampled by depth and added; backends picked by name.

``create("auto")`` gives ``cpu`` where the native kernels are installed, else ``oracle``, and says so once.
"""

from __future__ import annotations

import logging
from functools import cache

from cags_common.correction.base import (
    VETO_CELL_PX,
    Corrected,
    Corrector,
    CorrectSettings,
    Placement,
    Reference,
    veto_shape,
)
from cags_common.correction.changed import Spheres, changed_cells
from cags_common.correction.compander import compand, expand
from cags_common.correction.frames import Correction, FramePictures, FrameScene
from cags_common.correction.trust import layer
from cags_common.correction.views import ComparedViews, ComparingScene, DrawnViews, Look, StagedViews
from cags_common.errors import ConfigError

__all__ = [
    "NAMES",
    "VETO_CELL_PX",
    "ComparedViews",
    "ComparingScene",
    "CorrectSettings",
    "Corrected",
    "Correction",
    "Corrector",
    "DrawnViews",
    "FramePictures",
    "FrameScene",
    "Look",
    "Placement",
    "Reference",
    "Spheres",
    "StagedViews",
    "changed_cells",
    "compand",
    "create",
    "expand",
    "layer",
    "veto_shape",
]

_log = logging.getLogger(__name__)

NAMES = ("auto", "cpu", "oracle")
"""What :func:`create` takes."""


def create(name: str = "auto", threads: int = 2) -> Corrector:
    """A corrector for one client's frames. Raises :class:`ConfigError` for a backend that is unknown or cannot run."""
    import cags_kernels

    if name == "auto":
        name = "cpu" if cags_kernels.native_available() else "oracle"
        if name == "oracle":
            _warn_once(cags_kernels.why_unavailable())
    if name == "oracle":
        from cags_common.correction.oracle import ReferenceCorrector

        return ReferenceCorrector()
    if name == "cpu":
        from cags_common.correction.cpu import CpuCorrector

        return CpuCorrector(threads)
    raise ConfigError(f"corrector {name!r} is unknown; known: {', '.join(NAMES)}")


@cache
def _warn_once(reason: str) -> None:
    _log.warning("correcting by the readable reference code, which is slow: %s", reason)
