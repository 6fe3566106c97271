"""Builds the kernels with the address and undefined-behaviour sanitizers and runs the tests of every kernel on them.

    python kernels/sanitize.py                      all of them (minutes)
    python kernels/sanitize.py --short              what continuous integration runs: the kernels' own tests and a fuzz
    python kernels/sanitize.py tests/unit/kernels   pytest's own arguments

The build goes to a temporary folder; the installed library is not touched.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SHORT = (
    *("tests/unit/kernels", "tests/property/common/raster/test_fuzz.py"),
    *("tests/property/common/tiles/test_dequantise_properties.py", "tests/unit/common/coding/test_rans.py"),
)
ALL = (
    *("tests/unit/kernels", "tests/property/common/raster", "tests/stability/raster", "tests/unit/common/raster"),
    *("tests/stability/correction", "tests/unit/common/correction"),
    *("tests/unit/common/tiles", "tests/property/common/tiles"),
    *("tests/unit/common/coding", "tests/unit/common/motion", "tests/property/common/motion"),
)
"""Rasteriser, corrector, codec, motion: drawing, adding, tiles to splats, symbols and trees."""


def build(folder: str) -> str:
    """Path of the sanitized library."""
    cmake = shutil.which("cmake") or "cmake"
    configure = [cmake, "-S", str(ROOT / "kernels"), "-B", folder, "-DCMAKE_CXX_FLAGS=-O1", "-DCAGS_SANITIZE=ON"]
    subprocess.run(configure, check=True, stdout=subprocess.DEVNULL)
    subprocess.run([cmake, "--build", folder, "--parallel", "2"], check=True, stdout=subprocess.DEVNULL)
    return str(Path(folder) / "libcags_kernels.so")


def runtimes() -> str:
    """The sanitizers' shared libraries: they must be there before Python's own code."""
    compiler = os.environ.get("CXX", "c++")

    def path(name: str) -> str:
        asked = [compiler, f"-print-file-name={name}"]
        return subprocess.run(asked, capture_output=True, text=True, check=True).stdout.strip()

    return " ".join(path(name) for name in ("libasan.so", "libubsan.so"))


def main() -> int:
    """Exit code of pytest."""
    chosen = sys.argv[1:]
    tests = SHORT if chosen == ["--short"] else chosen or ALL
    with tempfile.TemporaryDirectory() as folder:
        environment = {
            **os.environ,
            "CAGS_KERNELS_LIBRARY": build(folder),
            "LD_PRELOAD": runtimes(),
            "ASAN_OPTIONS": "detect_leaks=0:abort_on_error=1",  # the interpreter itself leaks
            "UBSAN_OPTIONS": "print_stacktrace=1:halt_on_error=1",
        }
        command = [sys.executable, "-m", "pytest", "-q", "-s", "-p", "no:cacheprovider", *tests]
        return subprocess.run(command, cwd=ROOT, env=environment, check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
