"""The rasteriser seam and its backends, picked by name.

``create("auto")`` gives the fastest backend of the processor: ``cpu`` where the native kernels are installed, else
``oracle``, and says so once. ``chosen("auto")`` is ``gpu`` where a graphics processor is there.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from functools import cache

from cags_common.errors import ConfigError
from cags_common.raster.base import (
    DepthKind,
    Exactness,
    Footprint,
    Rasteriser,
    RasterScene,
    RenderedView,
    RenderOptions,
)
from cags_common.registry import Registry

__all__ = [
    "FACTORIES",
    "DepthKind",
    "Exactness",
    "Footprint",
    "RasterScene",
    "Rasteriser",
    "RenderOptions",
    "RenderedView",
    "chosen",
    "create",
]

_log = logging.getLogger(__name__)


def _oracle() -> Rasteriser:
    from cags_common.raster.oracle import OracleRasteriser

    return OracleRasteriser()


def _cpu() -> Rasteriser:
    from cags_common.raster.cpu import CpuRasteriser

    return CpuRasteriser()


FACTORIES: Registry[Callable[[], Rasteriser]] = Registry(
    "rasteriser", "cags.rasterisers", {"oracle": _oracle, "cpu": _cpu}, extra="gpu"
)
"""Backends by name: ``gpu`` comes from :mod:`cags_gpu`.

A factory raises :class:`ConfigError` with the reason when its backend cannot run here.
"""


def create(name: str = "auto") -> Rasteriser:
    """The rasteriser called ``name``: a key of :data:`FACTORIES`, or ``auto``. Raises :class:`ConfigError`.

    ``auto`` is a backend of the processor, whose pictures are the same on every machine: what is encoded or measured
    with it can be repeated. What draws for people asks :func:`chosen` first.
    """
    if name == "auto":
        return _automatic()
    return FACTORIES.find(name, also=("auto",))()


def chosen(name: str, tell: Callable[[str], None] = _log.info) -> str:
    """The backend that a client or server draws with when asked for ``name``: ``gpu`` for ``auto`` where it runs.

    ``tell`` hears in one line why it does not.
    """
    if name != "auto":
        return name
    try:
        return create("gpu").name
    except ConfigError as error:
        tell(f"not drawing on a graphics processor: {error}")
        return name


def _automatic() -> Rasteriser:
    import cags_kernels

    if cags_kernels.native_available():
        return _cpu()
    _warn_once(cags_kernels.why_unavailable())
    return _oracle()


@cache
def _warn_once(reason: str) -> None:
    _log.warning("rendering on the readable reference code, which is slow: %s", reason)
