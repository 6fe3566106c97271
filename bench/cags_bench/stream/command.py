"""``cags-bench stream``: one scene over one trace, in virtual time, every frame scored."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import Any

from cags_bench.stream.settings import StreamSettings
from cags_common.settings import add_settings, load_settings

SUMMARY = "Stream a scene over a network trace in virtual time and score every frame. Two runs print the same."

EXAMPLES = """\
  cags-bench stream --scene procedural --frames 60 --json
  cags-bench stream --scene frames/ --trace link.csv --poses walk.csv --restore none
  cags-bench stream --scene motion:plant.splat --trace generated:steady-30 --estimator oracle --out report
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Flags of the command."""
    add_settings(parser, StreamSettings)


def run(arguments: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """Yield the one summary line."""
    settings = load_settings(StreamSettings, arguments)
    from cags_bench.stream.experiment import stream

    yield stream(settings)
