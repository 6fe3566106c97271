"""``cags-bench cost``: sweeps every accuracy setting, measures time, bytes and quality, and plots the Pareto fronts."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import Any

from cags_bench.cost.settings import CostSettings
from cags_common.settings import add_settings, load_settings

SUMMARY = (
    "Measure the time and bytes of each step of accuracy, stage by stage and over whole sessions, with intervals and "
    "gains over the defaults."
)

EXAMPLES = """\
  cags-bench cost --out cost-page
  cags-bench cost --scenes "motion:plant.splat monkey-frames" --sizes 640x480,1600x1200 --json
  cags-bench cost --seeds 0 --budget-ms 33.3 --config-out client.toml
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's flags."""
    add_settings(parser, CostSettings)


def run(arguments: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """Yield one line per point, and the summary."""
    settings = load_settings(CostSettings, arguments)
    from cags_bench.cost.sweep import sweep

    yield from sweep(settings)
