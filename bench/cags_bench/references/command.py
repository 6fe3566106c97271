"""``cags-bench references``: sessions with each kind of reference, compared with each other and an earlier state."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import Any

from cags_bench.references.settings import ReferenceBenchSettings
from cags_common.settings import add_settings, load_settings

SUMMARY = (
    "Play scenes in virtual time with differences, pictures, the paper's method and no references: quality, flicker, "
    "bytes, processor time."
)

EXAMPLES = """\
  cags-bench references --shared ../shared --json
  cags-bench references --scenes 'procedural:size=30000' --links 30 --methods auto,none --json
  cags-bench references --before ../earlier/.venv/bin/python --methods auto --json
  cags-bench references --baseline earlier.jsonl --methods auto --full --json
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's flags."""
    add_settings(parser, ReferenceBenchSettings)


def run(arguments: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """One line per case and method, then a summary with its checks. Raises :class:`CagsError`."""
    settings = load_settings(ReferenceBenchSettings, arguments)
    from cags_bench.references.experiment import compared

    yield from compared(settings)
