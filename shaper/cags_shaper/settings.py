"""Settings of the shaper."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from cags_common.errors import ConfigError
from cags_common.settings import check_settings, setting
from cags_common.transport.hosts import is_host
from cags_shaper.link_clock import STARTS

if TYPE_CHECKING:
    from cags_shaper.link import LinkSettings


@dataclass(frozen=True)
class ShaperSettings:
    """Settings of ``cags-shaper``."""

    listen: str = setting("127.0.0.1:0", "HOST:PORT to listen on; port 0 picks a free one")
    to: str = setting("127.0.0.1:8765", "HOST:PORT to connect to")
    trace: str | None = setting(None, "trace of the direction towards the client; no rate limit when not given")
    uplink_trace: str | None = setting(None, "trace of the direction towards the server; no rate limit when not given")
    delay_ms: float = setting(0.0, "propagation delay each way, ms", low=0, high=60_000)
    jitter_ms: float = setting(0.0, "mean extra delay, exponential, order kept, ms", low=0, high=60_000)
    queue_bytes: int = setting(
        300_000, "size limit of each queue, bytes; a full queue blocks the sender", low=2000, high=2**31
    )
    queue_packets: int | None = setting(None, "size limit of each queue, packets; only with --tun", low=1, high=2**31)
    loss: float = setting(0.0, "probability that a packet is lost; only with --tun", low=0, high=0.99)
    tun: bool = setting(False, "shape packets of COMMAND, run in a namespace of its own (Linux, root), not streams")
    start: str = setting(
        "connection",
        "start of the traces: the first connection or the process; with --tun always COMMAND",
        choices=STARTS,
    )
    loop: bool = setting(True, "repeat the trace from its beginning at its end")
    seed: int = setting(0, "seed of the jitter", low=0, high=2**31)
    cap_mbps: float | None = setting(
        None, "upper limit of the rate in each direction, Mbps, in addition to the trace", low=0.001, high=1e6
    )
    control: str | None = setting(
        None, "HOST:PORT for live control of cap and delay by JSON lines; port 0 picks a free one"
    )
    log: str | None = setting(None, "write JSON lines of rate, queue and delay every 100 ms to this file")

    def __post_init__(self) -> None:
        check_settings(self)
        for flag in ("listen", "to", "control"):
            self.address(flag)
        if (target := self.address("to")) is not None and not target[1]:
            raise ConfigError(f"--to {self.to}: nothing listens on port 0; give the port of the server")
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
        host = host.strip("[]")
        if not is_host(host) or not port.isdecimal() or int(port) > 65535:
            raise ConfigError(f"--{flag} {text}: must be HOST:PORT, such as 127.0.0.1:8765")
        return host, int(port)

    def link(self) -> LinkSettings:
        """Effects of both links besides their traces."""
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
