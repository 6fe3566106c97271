"""The rasteriser seam and its backends, picked by name.

``create("auto")`` gives the fastest backend that runs everywhere: ``cpu`` where the native kernels are installed, else
``reference``, and says so once.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from functools import cache

from cags_common.errors import ConfigError
from cags_common.raster.base import (
    BackProjection,
    DepthKind,
    Exactness,
    Footprint,
    Rasteriser,
    RasterScene,
    RenderedView,
    RenderOptions,
    Shortcuts,
)

__all__ = [
    "FACTORIES",
    "BackProjection",
    "DepthKind",
    "Exactness",
    "Footprint",
    "RasterScene",
    "Rasteriser",
    "RenderOptions",
    "RenderedView",
    "Shortcuts",
    "create",
]

_log = logging.getLogger(__name__)


def _reference() -> Rasteriser:
    from cags_common.raster.reference import ReferenceRasteriser

    return ReferenceRasteriser()


def _cpu() -> Rasteriser:
    from cags_common.raster.cpu import CpuRasteriser

    return CpuRasteriser()


def _cuda() -> Rasteriser:
    from cags_common.raster.cuda import CudaRasteriser

    return CudaRasteriser()


FACTORIES: dict[str, Callable[[], Rasteriser]] = {"reference": _reference, "cpu": _cpu, "cuda": _cuda}
"""Backends by name. A factory raises :class:`ConfigError` with the reason when its backend cannot run here."""


def create(name: str = "auto") -> Rasteriser:
    """The rasteriser called ``name``: a key of :data:`FACTORIES`, or ``auto``. Raises :class:`ConfigError`."""
    if name == "auto":
        return _automatic()
    if name not in FACTORIES:
        raise ConfigError(f"rasteriser {name!r} is unknown; known: auto, {', '.join(FACTORIES)}")
    return FACTORIES[name]()


def _automatic() -> Rasteriser:
    import cags_kernels

    if cags_kernels.native_available():
        return _cpu()
    _warn_once(cags_kernels.why_unavailable())
    return _reference()


@cache
def _warn_once(reason: str) -> None:
    _log.warning("rendering on the readable reference code, which is slow: %s", reason)
