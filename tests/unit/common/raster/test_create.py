"""Backends by name, and what happens where one cannot run."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

import cags_kernels
from cags_common.errors import ConfigError
from cags_common.geometry import Intrinsics
from cags_common.raster import FACTORIES, Footprint, RenderOptions, create


def test_unknown_names_are_refused_with_the_known_ones():
    with pytest.raises(ConfigError, match=r"'cuda' is unknown; known: auto, .*cpu, gpu"):
        create("cuda")


def test_auto_is_the_native_backend_where_it_runs():
    expected = "cpu" if cags_kernels.native_available() else "oracle"
    assert create("auto").name == expected
    assert create("oracle").name == "oracle"
    assert set(FACTORIES.names()) == {"oracle", "cpu", "gpu"}


SCRIPT = """
import logging, sys
logging.basicConfig(stream=sys.stdout, format="%(message)s")
import cags_kernels
from cags_common.raster import create
from cags_common.errors import ConfigError
print(cags_kernels.native_available(), create().name, create().name)
try:
    create("cpu")
except ConfigError as error:
    print(error)
"""


def test_without_the_native_library_auto_falls_back_and_says_so_once(tmp_path):
    environment = {**os.environ, "CAGS_KERNELS_LIBRARY": str(tmp_path / "missing.so")}
    run = subprocess.run([sys.executable, "-c", SCRIPT], env=environment, capture_output=True, text=True, check=True)
    lines = run.stdout.splitlines()
    assert lines[0].startswith("rendering on the readable reference code")
    assert lines[1] == "False oracle oracle"
    assert "rasteriser 'cpu' cannot run" in lines[2]
    assert len(lines) == 3


def test_a_library_that_does_not_load_says_why(tmp_path):
    broken = tmp_path / "libcags_kernels.so"
    broken.write_bytes(b"not a library")
    environment = {**os.environ, "CAGS_KERNELS_LIBRARY": str(broken)}
    code = "import cags_kernels; print(cags_kernels.why_unavailable())"
    run = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert "cannot be loaded" in run.stdout


@pytest.mark.parametrize("values", [(-0.1, 0.5), (0.0, 0.0), (float("nan"), 0.3), (0.3, float("inf"))])
def test_footprints_that_cannot_be_drawn_are_refused(values):
    with pytest.raises(ValueError, match="footprint"):
        Footprint(*values)


@pytest.mark.parametrize("field", [{"void_alpha": 1.5}, {"max_sh_degree": 4}, {"threads": 0}])
def test_options_out_of_range_are_refused(field):
    with pytest.raises(ValueError, match=next(iter(field))):
        RenderOptions(**field)


def test_the_footprint_of_an_equal_or_finer_camera_is_classic():
    coarse, fine = Intrinsics.of_fov(100, 80, 1.0, 0.8), Intrinsics.of_fov(400, 320, 1.0, 0.8)
    assert Footprint.of(fine, fine) == Footprint.classic()
    assert Footprint.of(coarse, fine) == Footprint.classic()
    assert Footprint.of(fine, coarse) == Footprint(0.3 / 16, 1 / 12)
