"""A device for the tests of the shaders: hardware where there is some, else a software adapter, else a skip."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache

import pytest

from cags_common.errors import ConfigError
from cags_gpu.device import SOFTWARE_VARIABLE, Gpu, choose
from cags_gpu.keeper import Keeper, shared_keeper
from cags_gpu.raster import GpuRasteriser


@cache
def why_not() -> str:
    """Why there is no adapter of any kind; empty where there is one."""
    try:
        choose(software=True)
    except ConfigError as error:
        return str(error)
    return ""


needs_adapter = pytest.mark.skipif(bool(why_not()), reason=why_not())


def any_gpu() -> Gpu:
    """A device on whatever there is."""
    return Gpu(software=True)


@cache
def keeper() -> Keeper:
    """One device for all tests: making pipelines takes longer than drawing."""
    return Keeper(any_gpu)


def rasteriser() -> GpuRasteriser:
    """The backend on that device."""
    return GpuRasteriser(keeper())


@contextmanager
def software_passes() -> Iterator[None]:
    """Let ``create("gpu")`` take a software adapter, as the environment may ask; afterwards all is as before."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(SOFTWARE_VARIABLE, "1")
        shared_keeper.cache_clear()
        try:
            yield
        finally:
            shared_keeper.cache_clear()
