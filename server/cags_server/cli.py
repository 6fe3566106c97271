"""``cags-server``: serve one bundle to any number of clients."""

from __future__ import annotations

import json
import logging
import sys
from collections.abc import Sequence

from cags_common.cli import command_parser, run_command
from cags_common.settings import add_settings, load_settings
from cags_server.settings import ServeSettings

EXAMPLES = """\
  cags-server --bundle out/monkey
  cags-server --bundle out/monkey --port 0 --json        # a free port, told on stdout
  cags-server --bundle s3://bucket/monkey --host 0.0.0.0 --predictor linear --fov-margin 0.2
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit code."""
    return run_command("cags-server", _serve, argv)


def _serve(argv: Sequence[str]) -> None:
    parser = command_parser("cags-server", "Serve a bundle over HTTP and WebSocket.", EXAMPLES)
    add_settings(parser, ServeSettings)
    parser.add_argument("--json", action="store_true", help="print the ready line as JSON")
    arguments = parser.parse_args(argv)
    settings = load_settings(ServeSettings, arguments)
    logging.basicConfig(level=logging.INFO, stream=sys.stderr, format="%(asctime)s %(levelname)s %(message)s")

    import asyncio

    from cags_common import raster
    from cags_common.bundle import BundleReader
    from cags_server.app import serve
    from cags_server.library import SceneLibrary
    from cags_server.streamer import check_choices

    check_choices(settings)

    def ready(host: str, port: int) -> None:
        line = json.dumps({"ready": True, "host": host, "port": port})
        print(line if arguments.json else f"serving {settings.bundle} on ws://{host}:{port}/stream", flush=True)

    with BundleReader.open(settings.bundle) as reader:
        library = SceneLibrary(reader, raster.create(settings.rasteriser))
        asyncio.run(serve(library, settings, ready))
