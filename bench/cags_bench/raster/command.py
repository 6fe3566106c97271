"""``cags-bench raster``: speed and accuracy of the ``cpu`` backend and the prototype, in one interleaved run."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import Any

from cags_bench.raster.settings import BACKENDS, RasterSettings
from cags_common.settings import add_settings, load_settings

SUMMARY = "Time the CPU rasteriser and the prototype in interleaved runs, and measure the error against the reference."

EXAMPLES = """\
  cags-bench raster --shared ../shared --json
  cags-bench raster --sizes 400x300 --threads 2 --repetitions 5
  cags-bench raster --scenes procedural:size=100000 --no-growth
  cags-bench raster --backends cpu gpu --sizes 400x300,800x600 --json
  cags-bench raster --table --sizes 400x300,1600x1200 --json
  cags-bench raster --no-views --no-growth --sizes 1600x1200 --threads 2
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's flags."""
    add_settings(parser, RasterSettings)
    parser.add_argument(
        "--backends",
        nargs="+",
        choices=BACKENDS,
        help="instead: compare these backends with the definition, and measure correction and work",
    )


def run(arguments: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """The requested lines, the summary last."""
    settings = load_settings(RasterSettings, arguments)
    if arguments.backends:
        from cags_bench.raster.backends import measure_backends

        return measure_backends(settings, arguments.backends)
    if settings.table:
        from cags_bench.raster.hardware import measure_table

        return measure_table(settings)
    from cags_bench.raster.cases import measure

    return measure(settings)
