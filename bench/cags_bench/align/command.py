"""``cags-bench align``: what alignment, the closed-form restorer and the colour adapter cost, and what they bring."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import Any

SUMMARY = "time and quality of alignment, closed-form restoration and colour adaptation"
EXAMPLES = """\
  cags-bench align --json
  cags-bench align --scene procedural:size=12000,frames=36 --size 400x300 --ages 1,3,10 --json
  cags-bench align --scene ../shared/scenes/guitar/guitar.compressed.ply --size 1600x1200 --views 2 --json
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Flags of the subcommand."""
    parser.add_argument("--scene", default="procedural:size=60000", help="scene (default: procedural:size=60000)")
    parser.add_argument("--size", default="800x600", help="client pictures, WIDTHxHEIGHT (default: 800x600)")
    parser.add_argument("--views", type=int, default=2, help="poses of the walk (default: 2)")
    parser.add_argument("--repetitions", type=int, default=9, help="timed runs a stage (default: 9)")
    parser.add_argument("--threads", type=int, default=2, help="threads (default: 2)")
    parser.add_argument("--seed", type=int, default=0, help="seed of the walk and of the pose errors (default: 0)")
    parser.add_argument(
        "--ages", default="", help="instead: a moving scene with references this many media frames old, such as 1,3,10"
    )
    parser.add_argument("--cache", default="", help="folder of encoded bundles (default: the user's cache)")


def run(args: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """One line a case, then a summary with its checks. Raises :class:`CagsError`."""
    if args.ages:
        from cags_bench.align.ages import measure_ages

        yield from measure_ages(args)
        return
    from cags_bench.align.measure import measure

    yield from measure(args)
