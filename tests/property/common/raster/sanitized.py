"""Builds the kernels with the address and undefined-behaviour sanitizers and runs drawing and correction tests on them.

    python tests/property/common/raster/sanitized.py [pytest arguments]

Takes a few minutes. The build goes to a temporary folder; the installed library is not touched.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[4]
TESTS = (
    *("tests/property/common/raster", "tests/stability/raster", "tests/unit/common/raster"),
    *("tests/stability/correction", "tests/unit/common/correction"),
)


def build(folder: str) -> str:
    """Path of the sanitized library."""
    configure = ["cmake", "-S", str(ROOT / "kernels"), "-B", folder, "-DCMAKE_BUILD_TYPE=Release", "-DCAGS_SANITIZE=ON"]
    subprocess.run(configure, check=True, stdout=subprocess.DEVNULL)
    subprocess.run(["cmake", "--build", folder, "--parallel", "2"], check=True, stdout=subprocess.DEVNULL)
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
    with tempfile.TemporaryDirectory() as folder:
        environment = {
            **os.environ,
            "CAGS_KERNELS_LIBRARY": build(folder),
            "LD_PRELOAD": runtimes(),
            "ASAN_OPTIONS": "detect_leaks=0:abort_on_error=1",  # the interpreter itself leaks
            "UBSAN_OPTIONS": "print_stacktrace=1:halt_on_error=1",
        }
        command = [sys.executable, "-m", "pytest", "-q", "-s", "-p", "no:cacheprovider", *(sys.argv[1:] or TESTS)]
        return subprocess.run(command, cwd=ROOT, env=environment, check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
