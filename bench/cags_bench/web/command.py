"""``cags-bench web``: the viewer in a browser, from a published folder and from a server, over links."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import Any

from cags_bench.web.settings import WebBenchSettings
from cags_common.settings import add_settings, load_settings

SUMMARY = (
    "Play a scene in headless Chromium from a published folder behind nginx and from the server, through the shaper: "
    "first picture, stalls, displayed frames, a jump, quality, bytes of the page, caching, and the processor time "
    "of the worker for 60,000 moving splats. The browser draws on a software adapter: "
    "how many frames are displayed says as much about the machine as about the link."
)

EXAMPLES = """\
  cags-bench web --json
  cags-bench web --links 'generated:steady-8;generated:lte-driving' --sources published --pictures out/web --json
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Flags of the subcommand."""
    add_settings(parser, WebBenchSettings)


def run(arguments: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """Lines of the worker's cost and of the host, one a link and source, one a link of both, then the checks.

    Raises :class:`CagsError`.
    """
    settings = load_settings(WebBenchSettings, arguments)
    from cags_bench.web.experiment import plays

    yield from plays(settings)
