"""``cags-bench align``: what a client's frame takes with differences and pictures, and what its references cost."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import Any

from cags_bench.align.settings import AlignBenchSettings
from cags_common.settings import add_settings, load_settings

SUMMARY = (
    "Time of the client's frame: drawn, and what references say sampled by depth and added; and of the server's work "
    "for a reference."
)
EXAMPLES = """\
  cags-bench align --json
  cags-bench align --scene procedural:size=12000 --sizes 400x300 --repetitions 3 --json
  cags-bench align --scene ../shared/scenes/guitar/guitar.compressed.ply --sizes 1600x1200 --clients 1 --json
  cags-bench align --device gpu --sizes 1600x1200 --clients '' --json
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Flags of the subcommand."""
    add_settings(parser, AlignBenchSettings)


def run(args: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """A line a size and way to work, a line a number of clients, then a summary. Raises :class:`CagsError`."""
    settings = load_settings(AlignBenchSettings, args)
    from cags_bench.align.measure import measure

    yield from measure(settings)
