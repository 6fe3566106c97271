"""``cags-shaper``: a TCP proxy with the rate, delay and queue of a recorded network."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING

from cags_common.cli import command_parser, run_command
from cags_common.errors import ConfigError
from cags_common.settings import add_settings, given_flags, load_settings
from cags_shaper.settings import ShaperSettings

if TYPE_CHECKING:
    import argparse

EXAMPLES = """\
  cags-shaper --listen 127.0.0.1:9000 --to 127.0.0.1:8765 --trace traces/5g-mmwave.csv
  cags-shaper --listen 127.0.0.1:0 --to 127.0.0.1:8765 --trace generated:steady-30 --delay-ms 20 --queue-bytes 150000
  cags-shaper --listen 127.0.0.1:9000 --to 127.0.0.1:8765 --trace down.csv --uplink-trace up.mahi --log shaper.jsonl
  cags-shaper --plot shaper.jsonl
  sudo cags-shaper --tun --trace lte.csv --loss 0.01 -- sh -c 'cags-client --url ws://$CAGS_SHAPER_HOST:8765/stream'

a trace is a mahimahi file (one 1,504-byte opportunity a line, ms), rows `time_s,mbps`, rows `time mbps` (Pensieve), or
generated:NAME[:seed=N][:duration_s=N][:start_s=N] with NAME
5g-mmwave, lte-driving, step, sawtooth, blackout, steady-N (N Mbps)
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point of ``cags-shaper``."""
    return run_command("cags-shaper", _run, argv)


def _run(argv: Sequence[str]) -> int:
    parser = command_parser(
        "cags-shaper", "A TCP proxy with the rate, delay and queue of a recorded network.", EXAMPLES
    )
    add_settings(parser, ShaperSettings)
    parser.add_argument("command", nargs="*", metavar="COMMAND", help="with --tun: what to run behind the link")
    parser.add_argument("--plot", metavar="LOG", help="draw a log that --log wrote into a PNG beside it, and end")
    parser.add_argument("--json", action="store_true", help="print the ready line as JSON")
    arguments = parser.parse_args(argv)
    if arguments.plot is not None:
        return _plot(arguments.plot)
    settings = load_settings(ShaperSettings, arguments)
    if bool(arguments.command) != settings.tun:
        raise ConfigError("--tun and a COMMAND go together: cags-shaper --tun --trace FILE -- COMMAND")
    if settings.tun:
        _check_packets(arguments, settings)
    if arguments.command and shutil.which(arguments.command[0]) is None:
        raise ConfigError(f"COMMAND {arguments.command[0]!r} is no program here; give one that the shell would find")
    from cags_shaper.trace import open_trace

    traces = [
        open_trace(spec, loop=settings.loop) if spec else None for spec in (settings.trace, settings.uplink_trace)
    ]

    import asyncio
    import logging

    from cags_shaper.service import Service, run_packets

    logging.basicConfig(format="cags-shaper: %(message)s", stream=sys.stderr)
    if settings.tun:
        return asyncio.run(run_packets(settings, traces, arguments.command))
    asyncio.run(Service(settings, traces, arguments.json).run())
    return 0


def _check_packets(arguments: argparse.Namespace, settings: ShaperSettings) -> None:
    """Refuse options that only the proxy has, wherever they are set. Raises :class:`ConfigError`."""
    given, usual = given_flags(arguments, ShaperSettings), ShaperSettings()
    flags = [n for n in ("listen", "to") if n in given or getattr(settings, n) != getattr(usual, n)]
    if flags := [*flags, *(["json"] if arguments.json else [])]:
        raise ConfigError(
            f"--{flags[0]} is of the proxy: with --tun COMMAND connects by itself, to $CAGS_SHAPER_HOST; "
            f"leave out --{' and --'.join(flags)}"
        )


def _plot(log: str) -> int:
    from pathlib import Path

    from cags_shaper.plot import plot_log

    print(plot_log(Path(log)))
    return 0
