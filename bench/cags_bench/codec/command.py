"""``cags-bench codec``: bytes, picture quality and times of the quantisers at every LoD, beside other formats."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from cags_common.errors import ConfigError

SUMMARY = """\
Bytes, picture quality and times of the quantisers at their LoDs, beside SPZ, Draco alone and gzip of the floats, on
the same splats and views. Quality is taken over covered pixels (alpha > 0.01 in either picture)."""

EXAMPLES = """\
  cags-bench codec procedural:size=20000 --json
  cags-bench codec plant.splat angel.sog --quantisers layered paper-66 --views 8
  cags-bench codec plant.splat --lpips lpips_alex.npz --json"""

SHARED = Path("../shared/scenes")
_SHARED_SCENES = ("plant/plant.splat", "statues/angel.sog", "statues/st-peter.sog", "guitar/guitar.compressed.ply")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Flags of the command."""
    parser.add_argument(
        "scenes", nargs="*", metavar="SCENE", help="scenes; the shared captures beside the checkout, or procedural"
    )
    parser.add_argument("--quantisers", nargs="+", default=["layered", "paper-66", "paper-76"], metavar="NAME")
    parser.add_argument("--views", type=int, default=8, metavar="N", help="views around each scene (default: 8)")
    parser.add_argument("--points", type=int, default=8, metavar="N", help="LoDs drawn of each ladder (default: 8)")
    parser.add_argument("--width", type=int, default=640, metavar="PX", help="width of the pictures (default: 640)")
    parser.add_argument("--lpips", metavar="FILE", help="LPIPS weights (.npz); without them LPIPS is left out")
    parser.add_argument("--repeats", type=int, default=5, metavar="N", help="timed runs after a warm-up (default: 5)")


def run(arguments: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """Yield one line a scene, codec and LoD, and the summary with the targets."""
    for name in ("views", "points", "repeats"):
        if not 1 <= getattr(arguments, name) <= 1000:
            raise ConfigError(f"{name} = {getattr(arguments, name)} must lie in [1, 1000]")
    if not 64 <= arguments.width <= 4096:
        raise ConfigError(f"width = {arguments.width} must lie in [64, 4096]")
    from cags_bench.codec.experiment import compare

    yield from compare(arguments.scenes or _default_scenes(), arguments)


def _default_scenes() -> list[str]:
    there = [str(SHARED / name) for name in _SHARED_SCENES if (SHARED / name).exists()]
    return there or ["procedural:size=20000"]
