"""Compile the codec and motion kernels to WebAssembly: ``python web/wasm/build.py [OUT]``, by default
``web/dist/kernels.wasm``.

The compiler is clang as the PyPI package ``ziglang`` carries it, with a C++ library for WASI. The sources are those of
the native library; ``browser.cpp`` adds what a browser needs. Products and sums are never fused, as there: the module
gives the same bits as the native library and numpy.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
NATIVE = HERE.parents[1] / "kernels" / "src" / "native"
SOURCES = [
    HERE / "browser.cpp",
    *(
        NATIVE / name
        for name in (
            "codec/abi.cpp",
            "codec/symbols.cpp",
            "motion/apply.cpp",
            "motion/neighbours.cpp",
            "motion/symbols.cpp",
            "motion/tree.cpp",
        )
    ),
]
EXPORTS = (
    "cags_web_allocate",
    "cags_web_free",
    "cags_web_pack",
    "cags_codec_dequantise",
    "cags_codec_positions",
    "cags_codec_nearest",
    "cags_codec_decode",
    "cags_symbols_decoder_bytes",
    "cags_symbols_open",
    "cags_symbols_take",
    "cags_symbols_finish",
    "cags_motion_decode_tree",
    "cags_motion_neighbours",
    "cags_motion_rows",
)
FLAGS = (
    *("-target", "wasm32-wasi", "-mexec-model=reactor", "-std=c++20", "-O3", "-msimd128", "-s"),
    *("-fno-exceptions", "-fno-rtti", "-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math"),
    *("-Wall", "-Wextra", f"-I{NATIVE}", "-Wl,--gc-sections", "-Wl,--strip-all"),
    "-Wl,--initial-memory=33554432",
    "-Wl,--max-memory=2147483648",
)


def build(out: Path) -> None:
    """Compile the module to ``out``. Raises ``CalledProcessError`` where the compiler refuses."""
    out.parent.mkdir(parents=True, exist_ok=True)
    exports = [f"-Wl,--export={name}" for name in EXPORTS]
    compiler = [sys.executable, "-m", "ziglang", "c++"]
    subprocess.run([*compiler, *FLAGS, *exports, *map(str, SOURCES), "-o", str(out)], check=True)


if __name__ == "__main__":
    build(Path(sys.argv[1]) if len(sys.argv) > 1 else HERE.parent / "dist" / "kernels.wasm")
