"""``cags-bench reproduce``: every table and figure that needs no private data, with one command."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import Any

from cags_bench.reproduce.settings import ReproduceSettings
from cags_common.settings import add_settings, load_settings

SUMMARY = "Make the paper's tables and figures again. Resumable: results are kept by content, a second run goes on."

EXAMPLES = """\
  cags-bench reproduce --all --quick --out reproduction
  cags-bench reproduce --figure fixed --frames 150 --width 1600 --height 1200
  cags-bench reproduce --table components
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Flags of the command."""
    add_settings(parser, ReproduceSettings)


def run(arguments: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """Yield a line a table row, and the summary."""
    settings = load_settings(ReproduceSettings, arguments)
    from cags_bench.reproduce.run import reproduce

    yield from reproduce(settings)
