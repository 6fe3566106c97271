"""``cags-bench demo``: the demo itself, several times, on the machine as it is and with a core taken away."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import Any

from cags_bench.demo.settings import DemoBenchSettings
from cags_common.settings import add_settings, load_settings

SUMMARY = (
    "Play cags-demo in real time, several times: how many frames were displayed, how evenly, how good and how steady "
    "they were. The machine should do nothing else."
)

EXAMPLES = """\
  cags-bench demo --json
  cags-bench demo --runs 3 --parts quiet --before ../earlier/.venv/bin/python --json
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Flags of the command."""
    add_settings(parser, DemoBenchSettings)


def run(arguments: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """Yield one line a play, and the summary."""
    settings = load_settings(DemoBenchSettings, arguments)
    from cags_bench.demo.experiment import demo_lines

    yield from demo_lines(settings)
