"""``cags-server``: serve a bundle, or a folder of them, to any number of clients."""

from __future__ import annotations

import json
import logging
import sys
import time
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

from cags_common.cli import command_parser, run_command
from cags_common.runtime.rare_log import RareFilter
from cags_common.settings import add_settings, load_settings
from cags_server.settings import ServeSettings

log = logging.getLogger(__name__)

EXAMPLES = """\
  cags-server --bundle out/monkey
  cags-server --bundle out                               # every bundle in a folder, with a gallery
  cags-server --bundle out/monkey --port 0 --json        # a free port, printed on stdout
  cags-server --bundle s3://bucket/monkey --reference-share 0.1 --session-logs logs
  cags-server --bundle out/monkey --host 0.0.0.0 --token SECRET --tls-cert cert.pem --tls-key key.pem
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit code."""
    return run_command("cags-server", _serve, argv)


def _serve(argv: Sequence[str]) -> None:
    parser = command_parser("cags-server", "Serve a bundle, or a folder of bundles, over HTTP and WebSocket.", EXAMPLES)
    add_settings(parser, ServeSettings)
    parser.add_argument("--json", action="store_true", help="print the line that says the server is ready as JSON")
    parser.add_argument("--headless", action="store_true", help="print no live table, even in a terminal")
    arguments = parser.parse_args(argv)
    settings = load_settings(ServeSettings, arguments)
    _start_logging(settings)

    import asyncio

    from cags_common import raster
    from cags_common.files import writable_folder
    from cags_common.runtime.terminal import live_table, watched
    from cags_common.transport.hosts import host_port
    from cags_server.http.admission import tls_context
    from cags_server.http.app import App, serve
    from cags_server.http.console import sessions_table
    from cags_server.http.memory import share_arenas
    from cags_server.http.page import browsed, why_missing
    from cags_server.scene.collection import Collection
    from cags_server.session.policies import check_choices

    share_arenas()
    check_choices(settings)
    tls_context(settings.tls_cert, settings.tls_key)
    for folder in filter(None, (settings.session_logs, settings.event_traces)):
        writable_folder(Path(folder))

    def ready(host: str, port: int, app: App) -> None:
        scheme = "wss" if settings.tls_cert else "ws"
        line = json.dumps({"ready": True, "host": host, "port": port, "scheme": scheme})
        address = f"{scheme}://{host_port(host, port)}/stream"
        watch = f"{'https' if settings.tls_cert else 'http'}://{host_port(browsed(host), port)}/"
        print(line if arguments.json else f"serving {settings.bundle} on {address}", flush=True)
        if not arguments.json:
            print(f"watch it in a browser: {watch}" if missing is None else missing, flush=True)
        for note in notes:
            logging.getLogger(__name__).info(note)
        if watched(headless=arguments.headless or arguments.json):
            shown.enter_context(live_table(lambda: sessions_table(address, app.sessions())))

    missing = why_missing()
    if missing is not None and arguments.json:
        logging.getLogger(__name__).warning(missing)
    notes: list[str] = []  # told once the server listens: what keeps it from that is one line
    if settings.host not in ("127.0.0.1", "::1", "localhost") and not settings.token:
        logging.getLogger(__name__).warning(
            "listening on %s without --token: anyone who reaches it may watch", settings.host
        )
    with ExitStack() as shown:
        scenes = Collection.open(
            settings.bundle,
            lambda: raster.create(raster.chosen(settings.rasteriser, notes.append)),
            may_be_empty=settings.accept_uploads,
            decoded_bytes=round(settings.decoded_mb * 1e6),
        )
        asyncio.run(serve(scenes, settings, ready))


class _Formatter(logging.Formatter):
    """Times as RFC 3339 writes them, in UTC: lines of servers in several places can be put in order."""

    converter = staticmethod(time.gmtime)
    default_time_format = "%Y-%m-%dT%H:%M:%S"
    default_msec_format = "%s.%03dZ"


class _JsonFormatter(_Formatter):
    """One JSON object a line."""

    def format(self, record: logging.LogRecord) -> str:
        line = {"time": self.formatTime(record), "level": record.levelname, "message": record.getMessage()}
        if record.exc_info:
            line["error"] = self.formatException(record.exc_info)
        return json.dumps(line)


def _start_logging(settings: ServeSettings) -> None:
    handler = logging.StreamHandler(sys.stderr)
    plain = _Formatter("%(asctime)s %(levelname)s %(message)s")
    handler.setFormatter(_JsonFormatter() if settings.log_format == "json" else plain)
    handler.addFilter(RareFilter())
    logging.basicConfig(level=logging.INFO, handlers=[handler])
