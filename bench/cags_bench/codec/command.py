"""``cags-bench codec``: bytes, quality and times of the quantisers at every LoD, compared with other formats."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from cags_common.errors import ConfigError
from cags_encoder.settings import QUANTISERS

SUMMARY = """\
Measure bytes, picture quality and times of the quantisers at their LoDs, and of SPZ, SOG, Draco alone and gzipped
floats, on the same splats and views. Quality is measured over covered pixels (alpha > 0.01 in either picture)."""

EXAMPLES = """\
  cags-bench codec procedural:size=20000 --json
  cags-bench codec plant.splat angel.sog --quantisers layered paper-66 --views 8
  cags-bench codec plant.splat --lpips lpips_alex.npz --json
  cags-bench codec plant.splat --quantisers layered --points 2 --clip frames/ --workers 1 2 --json
  npm install --prefix sog @playcanvas/splat-transform && cags-bench codec plant.splat --splat-transform sog --json"""

SHARED = Path("../shared")
_SHARED_SCENES = (
    "scenes/plant/plant.splat",
    "scenes/statues/angel.sog",
    "scenes/statues/st-peter.sog",
    "scenes/guitar/guitar.compressed.ply",
    "scenes/playbot/1_0",
)
_SHARED_LPIPS = SHARED / "lpips/lpips_alex.npz"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's flags."""
    parser.add_argument(
        "scenes", nargs="*", metavar="SCENE", help="scenes (default: the shared captures, or procedural)"
    )
    parser.add_argument("--quantisers", nargs="+", default=QUANTISERS, metavar="NAME")
    parser.add_argument("--views", type=int, default=8, metavar="N", help="views around each scene (default: 8)")
    parser.add_argument(
        "--points", type=int, default=8, metavar="N", help="LoDs to render for each quantiser (default: 8)"
    )
    parser.add_argument("--width", type=int, default=640, metavar="PX", help="width of the pictures (default: 640)")
    parser.add_argument(
        "--lpips",
        metavar="FILE",
        default=str(_SHARED_LPIPS) if _SHARED_LPIPS.exists() else None,
        help="LPIPS weights (.npz; default: those beside the checkout, if present)",
    )
    parser.add_argument(
        "--splat-transform", metavar="FOLDER", help="folder in which npm installed @playcanvas/splat-transform"
    )
    parser.add_argument("--threads", type=int, default=2, metavar="N", help="decoding threads (default: 2)")
    parser.add_argument(
        "--ablations", action="store_true", help="also measure the default with one feature removed at a time"
    )
    parser.add_argument("--clip", metavar="SCENE", help="moving scene to encode with each number of --workers")
    parser.add_argument("--clip-frames", type=int, default=24, metavar="N", help="frames of the clip (default: 24)")
    parser.add_argument(
        "--workers", type=int, nargs="+", default=[1, 2], metavar="N", help="numbers of processes (default: 1 2)"
    )
    parser.add_argument("--repeats", type=int, default=5, metavar="N", help="timed runs after a warm-up (default: 5)")


def run(arguments: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """Yield one line per scene, codec and LoD, one per number of workers, and the summary with the targets."""
    counts = [(name, getattr(arguments, name)) for name in ("views", "points", "repeats", "threads", "clip_frames")]
    for name, value in [*counts, *(("workers", count) for count in arguments.workers)]:
        if not 1 <= value <= 1000:
            raise ConfigError(f"{name} = {value} must lie in [1, 1000]")
    if not 64 <= arguments.width <= 4096:
        raise ConfigError(f"width = {arguments.width} must lie in [64, 4096]")
    from cags_bench.codec.experiment import compare

    yield from compare(arguments.scenes or _default_scenes(), arguments)


def _default_scenes() -> list[str]:
    shared = [str(SHARED / name) for name in _SHARED_SCENES if (SHARED / name).exists()]
    return shared or ["procedural:size=20000"]
