"""Parts of the program: kernels, codecs, graphics card, optional packages."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from importlib.metadata import version
from importlib.util import find_spec

from cags_bench.doctor.findings import Finding, fine, missing, note
from cags_common.errors import CagsError, ConfigError

OPTIONAL = {
    "distributed": ("encoding on several machines", "pip install 'cags-stream[scale]'"),
    "s3fs": ("bundles in S3 or MinIO", "pip install 'cags-stream[scale]'"),
}
ROUNDTRIP_LEVELS = 8
"""Largest error of a grey H.264 picture at crf 20 after a round trip, in 8-bit levels; wrong colour tags cause more."""


def part_findings() -> Iterator[Finding]:
    """Run a small trial of each part."""
    yield guarded("kernels", kernels)
    yield guarded("H.264", h264)
    yield guarded("Draco", draco)
    yield guarded("k-means", kmeans)
    yield guarded("GPU", gpu)
    for package, (purpose, remedy) in OPTIONAL.items():
        yield optional(package, purpose, remedy)


def guarded(matter: str, trial: Callable[[], Finding]) -> Finding:
    """Run a trial; its failure becomes a finding."""
    try:
        return trial()
    except (ImportError, OSError, RuntimeError, ValueError, CagsError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        return missing(matter, reason, "install the program again: pip install -c constraints.txt ./kernels -e .")


def kernels() -> Finding:
    """The native rasteriser."""
    from cags_kernels import instruction_set, native_available, why_unavailable

    if not native_available():
        remedy = "install a C++20 compiler (apt-get install g++), then pip install --force-reinstall ./kernels"
        return missing("kernels", f"reference path only: {why_unavailable()}", remedy)
    ours, theirs = version("cags-stream"), version("cags-kernels")
    if ours != theirs:
        found = f"version {theirs}, but cags-stream has version {ours}"
        return missing(
            "kernels", found, "install both with the same version: pip install -c constraints.txt ./kernels -e ."
        )
    return fine("kernels", f"native, {instruction_set()}")


def h264() -> Finding:
    """Encode and decode one picture."""
    import numpy as np

    from cags_common.video.h264 import H264Decoder, H264Encoder

    picture = np.full((64, 96, 3), 0.5, np.float32)
    decoded = H264Decoder().decode(H264Encoder(96, 64, 30.0).encode(picture))
    if decoded is None or float(np.abs(decoded - picture).max()) * 255 > ROUNDTRIP_LEVELS:
        return missing(
            "H.264", "a grey picture changes in a round trip", "install av again: pip install --force-reinstall av"
        )
    return fine("H.264", "libx264 and decoder passed a round trip of one picture")


def draco() -> Finding:
    """Encode and decode a few points with Draco, in order."""
    import DracoPy
    import numpy as np

    points = np.arange(24, dtype=np.float32).reshape(8, 3)[::-1]
    lattice = {"quantization_bits": 5, "quantization_range": 31.0, "quantization_origin": np.zeros(3)}
    back = DracoPy.decode(DracoPy.encode(points, preserve_order=True, **lattice)).points
    if not np.allclose(back, points, atol=1e-3):
        return missing(
            "Draco", "points change in a round trip", "install it again: pip install --force-reinstall DracoPy"
        )
    return fine("Draco", "passed a round trip of ordered points")


def kmeans() -> Finding:
    """The encoder's clustering."""
    import faiss

    return fine("k-means", f"faiss {faiss.__version__}")


def gpu() -> Finding:
    """The optional graphics processor: adapter, driver and limits."""
    from cags_gpu.device import choose

    try:
        info, _ = choose()
    except ConfigError as error:
        return note("GPU", str(error), "not needed: frames are drawn by the CPU")
    sizes = f"binds {info.max_binding_bytes >> 20} MiB, buffers of {info.max_buffer_bytes >> 20} MiB"
    return fine("GPU", f"{info}; {sizes}; timestamps: {'yes' if info.timestamps else 'no'}")


def optional(package: str, purpose: str, remedy: str) -> Finding:
    """A package that only some uses need."""
    if find_spec(package) is None:
        return note(package, f"absent; needed for {purpose}", remedy)
    return fine(package, purpose)
