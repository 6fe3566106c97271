"""Files with large claims: the memory to read them, measured in a separate process, stays within a budget."""

from __future__ import annotations

import gzip
import subprocess
import sys
import time
import zipfile
from pathlib import Path

import numpy as np
import pytest

from cags_common.errors import SceneError
from cags_encoder.formats.npz_arrays import MAX_INFLATED_BYTES, NpzArrays
from cags_encoder.formats.ply import ply_bytes
from cags_encoder.formats.spz import HEADER, parse_spz, spz_bytes
from cags_encoder.formats.spz_header import MAGIC
from cags_encoder.scenes import open_scene
from support.splat_files import random_splats

MEASURE = """
import resource, sys
from cags_encoder.scenes import open_scene
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
try:
    open_scene(sys.argv[1])
except Exception as error:
    print(error)
print((resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024)
"""


def peak_mb(path: Path) -> tuple[str, float]:
    """Result of opening a scene, and the peak memory."""
    command = [sys.executable, "-c", MEASURE, str(path)]
    lines = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120).stdout.splitlines()
    return " ".join(lines[:-1]), float(lines[-1])


def npz(path: Path, sizes: dict[str, tuple[int, ...]]) -> None:
    """A deflated archive of zeros, written piece by piece."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name, shape in sizes.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as file:
                head = {"descr": "<f4", "fortran_order": False, "shape": shape}
                np.lib.format.write_array_header_1_0(file, head)
                left, block = int(np.prod(shape)) * 4, bytes(1 << 22)
                while left:
                    left -= file.write(block[: min(left, len(block))])


def test_an_array_of_another_shape_is_refused_before_it_is_inflated(tmp_path: Path) -> None:
    npz(tmp_path / "params.npz", {"means3D": (1 << 25, 4)})
    words, mb = peak_mb(tmp_path / "params.npz")
    assert "means3D has shape (33554432, 4), expected" in words
    assert mb < 64


def test_all_that_an_archive_inflates_to_is_bounded(tmp_path: Path) -> None:
    half = MAX_INFLATED_BYTES // 2
    npz(tmp_path / "params.npz", {"a": (half // 4 // 3, 3)})
    archive = NpzArrays(tmp_path / "params.npz")
    archive._inflated_bytes = half + 1024
    with pytest.raises(SceneError, match=r"inflate to over 1073741824 bytes; save the file without compression"):
        archive.array("a", 3)


def test_an_inflated_array_takes_its_own_memory_once(tmp_path: Path) -> None:
    script = """
import resource, sys
from pathlib import Path
from cags_encoder.formats.npz_arrays import NpzArrays
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
array = NpzArrays(Path(sys.argv[1])).array("a", 4)
print((resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024 / (array.nbytes / 2**20))
"""
    npz(tmp_path / "x.npz", {"a": (1 << 23, 4)})
    done = subprocess.run(
        [sys.executable, "-c", script, str(tmp_path / "x.npz")], capture_output=True, text=True, check=True, timeout=120
    )
    assert float(done.stdout) < 1.3


def test_ten_million_splats_in_a_few_bytes_are_refused_at_once(tmp_path: Path) -> None:
    header = HEADER.pack(MAGIC, 3, 10_000_000, 0, 12, 0, 0)
    claims = gzip.compress(header + bytes(20 * 10_000_000), compresslevel=1)
    begun = time.perf_counter()
    with pytest.raises(SceneError, match=r"x\.spz: claims 10000000 splats in \d+ bytes, too few for that many"):
        parse_spz(claims, "x.spz")
    assert time.perf_counter() - begun < 1.0
    assert len(parse_spz(spz_bytes(random_splats(50)), "y.spz")) == 50


@pytest.mark.parametrize("value", [1e30, -1e31, 3e38])
def test_coordinates_that_no_bundle_can_carry_are_refused_with_the_files_name(tmp_path: Path, value: float) -> None:
    splats = random_splats(5)
    splats.means[3, 1] = value
    (tmp_path / "far.ply").write_bytes(ply_bytes(splats))
    with pytest.raises(SceneError, match=r"far\.ply: means\[3\]\[1\] = .* lies beyond 1e\+30"):
        open_scene(str(tmp_path / "far.ply")).frame(0)
    assert len(open_scene(f"{tmp_path / 'far.ply'}:repair=drop").frame(0)) == 4
