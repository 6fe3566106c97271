"""``cags-bench stream``: plays a scene or bundle over a trace in virtual time and scores every frame."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator
from typing import IO, Any

from cags_bench.stream.settings import add_arguments, load

__all__ = ["EXAMPLES", "SUMMARY", "add_arguments", "run", "show"]

SUMMARY = (
    "Stream a scene or a bundle over a network trace in virtual time, and score every frame. Two runs print the "
    "same results."
)

EXAMPLES = """\
  cags-bench stream --scene procedural --frames 60
  cags-bench stream --scene clip.cags --compare abr=paper,utility --seeds 5
  cags-bench stream --scene frames/ --trace link.csv --poses walk.csv --restore none --json
  cags-bench stream --scene motion:plant.splat --out report --strip 30 --record film.mp4 --record-truth
"""


def run(arguments: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """Yield one line per play, and the summary."""
    settings = load(arguments)
    from cags_bench.stream.experiment import stream_lines

    yield from stream_lines(settings)


def show(lines: Iterable[dict[str, Any]], stream: IO[str]) -> None:
    """Print the lines of :func:`run` as text."""
    from cags_bench.stream.tables import print_plays

    print_plays(lines, stream)
