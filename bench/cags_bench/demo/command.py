"""``cags-bench demo``: plays the demo several times, on the idle machine and with a core occupied."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import Any

from cags_bench.demo.settings import DemoBenchSettings
from cags_common.settings import add_settings, load_settings

SUMMARY = (
    "Play cags-demo in real time, several times, and measure displayed frames, their regularity, quality and "
    "steadiness. The machine should be idle otherwise."
)

EXAMPLES = """\
  cags-bench demo --json
  cags-bench demo --runs 3 --parts quiet --before ../earlier/.venv/bin/python --json
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's flags."""
    add_settings(parser, DemoBenchSettings)


def run(arguments: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """Yield one line per play, and the summary."""
    settings = load_settings(DemoBenchSettings, arguments)
    from cags_bench.demo.experiment import demo_lines

    yield from demo_lines(settings)
