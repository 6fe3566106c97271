"""``cags-shaper``: a TCP proxy with the rate, delay and queue of a recorded network."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from cags_common.cli import command_parser, run_command
from cags_common.errors import ConfigError
from cags_common.settings import add_settings, check_settings, load_settings, setting
from cags_shaper.link_clock import STARTS

if TYPE_CHECKING:
    from cags_shaper.link import LinkSettings
    from cags_shaper.trace import Trace

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


@dataclass(frozen=True)
class ShaperSettings:
    """Settings of ``cags-shaper``."""

    listen: str = setting("127.0.0.1:0", "HOST:PORT to listen on; port 0 picks a free one")
    to: str = setting("127.0.0.1:8765", "HOST:PORT to connect to")
    trace: str | None = setting(None, "trace of the direction towards the client; none: no rate limit")
    uplink_trace: str | None = setting(None, "trace of the direction towards the server; none: no rate limit")
    delay_ms: float = setting(0.0, "propagation delay each way, ms", low=0, high=60_000)
    jitter_ms: float = setting(0.0, "mean extra delay, exponential, order kept, ms", low=0, high=60_000)
    queue_bytes: int = setting(300_000, "bound of each queue; full, it holds the sender back", low=2000, high=2**31)
    queue_packets: int | None = setting(None, "bound of each queue in packets; only with --tun", low=1, high=2**31)
    loss: float = setting(0.0, "probability that a packet is lost; only with --tun", low=0, high=0.99)
    tun: bool = setting(False, "shape packets of COMMAND, run in a namespace of its own (Linux, root), not streams")
    start: str = setting("connection", "what the traces begin with; with --tun always COMMAND", choices=STARTS)
    loop: bool = setting(True, "start the trace again at its end")
    seed: int = setting(0, "seed of the jitter", low=0, high=2**31)
    cap_mbps: float | None = setting(None, "highest rate each way, whatever the trace allows", low=0.001, high=1e6)
    control: str | None = setting(None, "HOST:PORT for live control of cap and delay (JSON lines); port 0: a free one")
    log: str | None = setting(None, "write JSON lines of rate, queue and delay every 100 ms to this file")

    def __post_init__(self) -> None:
        check_settings(self)
        for flag in ("listen", "to", "control"):
            self.address(flag)
        if not self.tun and (self.loss or self.queue_packets is not None):
            raise ConfigError(
                "--loss and --queue-packets act on packets: a stream loses nothing; add --tun and a COMMAND"
            )

    def address(self, flag: str) -> tuple[str, int] | None:
        """The ``HOST:PORT`` of a flag (an IPv6 host in brackets), None if not given. Raises :class:`ConfigError`."""
        text = getattr(self, flag)
        if text is None:
            return None
        host, _, port = text.rpartition(":")
        if not host or not port.isdecimal() or int(port) > 65535:
            raise ConfigError(f"--{flag} {text}: must be HOST:PORT, such as 127.0.0.1:8765")
        return host.strip("[]"), int(port)

    def link(self) -> LinkSettings:
        """What both links do besides their traces."""
        from cags_shaper.link import LinkSettings

        return LinkSettings(
            delay_us=round(self.delay_ms * 1000),
            jitter_us=round(self.jitter_ms * 1000),
            loss=self.loss,
            queue_bytes=self.queue_bytes,
            queue_packets=self.queue_packets,
            seed=self.seed,
            cap_bps=None if self.cap_mbps is None else self.cap_mbps * 1e6,
        )


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
    if arguments.command and shutil.which(arguments.command[0]) is None:
        raise ConfigError(f"COMMAND {arguments.command[0]!r} is no program here; give one that the shell would find")
    from cags_shaper.trace import open_trace

    traces = [
        open_trace(spec, loop=settings.loop) if spec else None for spec in (settings.trace, settings.uplink_trace)
    ]

    import asyncio
    import logging

    if settings.tun:
        return _run_packets(settings, traces, arguments.command)
    from cags_shaper.service import Service

    logging.basicConfig(format="cags-shaper: %(message)s", stream=sys.stderr)
    asyncio.run(Service(settings, traces, arguments.json).run())
    return 0


def _run_packets(settings: ShaperSettings, traces: list[Trace | None], command: list[str]) -> int:
    import asyncio
    import os

    from cags_shaper.link import Link
    from cags_shaper.tun import TunNames, run_behind

    down: Link[bytes] = Link(traces[0], settings.link())
    up: Link[bytes] = Link(traces[1], settings.link())
    return asyncio.run(run_behind(command, TunNames(os.getpid()), down, up))


def _plot(log: str) -> int:
    from pathlib import Path

    from cags_shaper.plot import plot_log

    print(plot_log(Path(log)))
    return 0
