"""``cags-bench align``: time of a client's frame with differences and pictures, and the server's cost of references."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import Any

from cags_bench.align.settings import AlignBenchSettings
from cags_common.settings import add_settings, load_settings

SUMMARY = (
    "Measure the time of a client's frame, drawn and corrected by a reference, and of the server's work "
    "for a reference."
)
EXAMPLES = """\
  cags-bench align --json
  cags-bench align --scene procedural:size=12000 --sizes 400x300 --repetitions 3 --json
  cags-bench align --scene ../shared/scenes/guitar/guitar.compressed.ply --sizes 1600x1200 --clients 1 --json
  cags-bench align --device gpu --sizes 1600x1200 --clients '' --json
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's flags."""
    add_settings(parser, AlignBenchSettings)


def run(args: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """One line per size and method, one per number of clients, then a summary. Raises :class:`CagsError`."""
    settings = load_settings(AlignBenchSettings, args)
    from cags_bench.align.measure import measure

    yield from measure(settings)
