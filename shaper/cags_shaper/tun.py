"""Packets instead of streams: a command behind a link that really delays, queues and loses, as mahimahi's shells do.

The command runs in a network namespace of its own whose only way out is a TUN device; another one is its peer in this
namespace, and this process carries packets between them through two links. TCP on both sides is the kernel's own, so
loss and drop-tail act on real retransmissions. Linux and root only.
"""

from __future__ import annotations

import asyncio
import contextlib
import fcntl
import ipaddress
import os
import shutil
import signal
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass
from pathlib import Path

from cags_common.errors import ConfigError, NetworkError
from cags_shaper.link import Link
from cags_shaper.link_clock import LinkClock

TUN = Path("/dev/net/tun")
TUNSETIFF = 0x400454CA
IFF_TUN, IFF_NO_PI = 0x0001, 0x1000
MTU_BYTES = 1500
TUN_HEADER_BYTES = 4
"""mahimahi counts a packet with its TUN header."""

READ_BATCH = 64

HOST_VARIABLE = "CAGS_SHAPER_HOST"


@dataclass(frozen=True)
class TunNames:
    """Names and addresses of one pair of devices; ``number`` keeps pairs on one machine apart."""

    number: int

    @property
    def namespace(self) -> str:
        """Network namespace of the command."""
        return f"cags{self.number}"

    @property
    def devices(self) -> tuple[str, str]:
        """Outer and inner device."""
        return f"cagso{self.number}", f"cagsi{self.number}"

    @property
    def addresses(self) -> tuple[str, str]:
        """Outer and inner address: a /30 of 10.78.0.0/16."""
        network = ipaddress.ip_network("10.78.0.0/16")
        base = int(network.network_address) + 4 * (self.number % 16384)
        return str(ipaddress.ip_address(base + 1)), str(ipaddress.ip_address(base + 2))


def why_unavailable() -> str | None:
    """Why packets cannot be shaped here; None if they can."""
    if sys.platform != "linux":
        return f"TUN devices are Linux's, this is {sys.platform}"
    if os.geteuid() != 0:
        return "making a TUN device needs root"
    if not TUN.exists():
        return f"{TUN} is missing"
    if shutil.which("ip") is None:
        return "the command `ip` (iproute2) is missing"
    return None


@contextlib.contextmanager
def tun_pair(names: TunNames) -> Iterator[tuple[int, int]]:
    """File descriptors of the outer and the inner device, up and addressed.

    Raises :class:`ConfigError` where this cannot work, :class:`NetworkError` where it fails.
    """
    reason = why_unavailable()
    if reason is not None:
        raise ConfigError(f"--tun cannot run here: {reason}; leave --tun out to shape streams by proxy")
    with contextlib.ExitStack() as stack:
        _ip("netns", "add", names.namespace)
        stack.callback(_ip, "netns", "delete", names.namespace)
        fds = tuple(_open_device(name, stack) for name in names.devices)
        outer, inner = names.devices
        _ip("link", "set", inner, "netns", names.namespace)
        inside = ("-netns", names.namespace)
        ends = ((), outer, names.addresses), (inside, inner, names.addresses[::-1])
        for where, device, (local, remote) in ends:
            _ip(*where, "address", "add", local, "peer", remote, "dev", device)
            _ip(*where, "link", "set", device, "mtu", str(MTU_BYTES), "up")
        _ip(*inside, "link", "set", "lo", "up")
        _ip(*inside, "route", "add", "default", "via", names.addresses[0])
        yield fds[0], fds[1]


class PacketDirection:
    """Carries packets from one device to the other through a link, in the running event loop."""

    def __init__(self, link: Link[bytes], clock: LinkClock, source: int, target: int) -> None:
        self.link, self.clock = link, clock
        self._source, self._target = source, target
        self._loop = asyncio.get_running_loop()
        self._timer: asyncio.TimerHandle | None = None
        self._loop.add_reader(source, self._read)

    def now_us(self) -> int:
        """Time since the link started."""
        return self.clock.now_us()

    def close(self) -> None:
        """Carry no more."""
        self._loop.remove_reader(self._source)
        if self._timer is not None:
            self._timer.cancel()

    def _read(self) -> None:
        with contextlib.suppress(BlockingIOError):
            for _ in range(READ_BATCH):
                packet = os.read(self._source, MTU_BYTES + 100)
                self.link.push(self.now_us(), packet, len(packet) + TUN_HEADER_BYTES)
        self._deliver()

    def _deliver(self) -> None:
        for packet in self.link.pop_due(self.now_us()):
            with contextlib.suppress(OSError):  # the device is going down: the packet is lost, as on any link
                os.write(self._target, packet)
        if self._timer is not None:
            self._timer.cancel()
        next_us = self.link.next_delivery_us()
        delay_s = 0.0 if next_us is None else max(next_us - self.now_us(), 0) / 1e6
        self._timer = None if next_us is None else self._loop.call_later(delay_s, self._deliver)


@dataclass(frozen=True)
class PacketPair:
    """Both directions of a link that carries packets; they share a clock."""

    downlink: PacketDirection
    uplink: PacketDirection

    def close(self) -> None:
        """Carry no more."""
        self.downlink.close()
        self.uplink.close()


async def run_behind(
    command: Sequence[str],
    names: TunNames,
    downlink: Link[bytes],
    uplink: Link[bytes],
    beside: Callable[[PacketPair], AbstractAsyncContextManager[object]] = contextlib.nullcontext,
) -> int:
    """Run ``command`` behind the links and return its exit status. Raises :class:`ConfigError` and `NetworkError`.

    Inside, this machine is ``names.addresses[0]``, which the command finds in the variable ``CAGS_SHAPER_HOST``.
    SIGTERM and SIGINT are passed on. What ``beside`` makes of both directions is entered before the command starts and
    left after it has ended.
    """
    environment = {**os.environ, HOST_VARIABLE: names.addresses[0]}
    with tun_pair(names) as (outer, inner), contextlib.ExitStack() as stack:
        clock = LinkClock(lambda: time.monotonic_ns() // 1000)
        pair = PacketPair(PacketDirection(downlink, clock, outer, inner), PacketDirection(uplink, clock, inner, outer))
        stack.callback(pair.close)
        async with beside(pair):
            clock.begin()
            process = await asyncio.create_subprocess_exec(
                "ip", "netns", "exec", names.namespace, *command, env=environment
            )
            loop = asyncio.get_running_loop()
            for number in (signal.SIGTERM, signal.SIGINT):
                loop.add_signal_handler(number, _pass_on, process, number)
            return await process.wait()


def _pass_on(process: asyncio.subprocess.Process, number: int) -> None:
    with contextlib.suppress(ProcessLookupError):
        process.send_signal(number)


def _open_device(name: str, stack: contextlib.ExitStack) -> int:
    try:
        fd = os.open(TUN, os.O_RDWR | os.O_NONBLOCK)
        stack.callback(os.close, fd)
        fcntl.ioctl(fd, TUNSETIFF, struct.pack("16sH22x", name.encode(), IFF_TUN | IFF_NO_PI))
    except OSError as error:
        raise NetworkError(f"TUN device {name}: cannot be made ({error.strerror})") from error
    return fd


def _ip(*arguments: str) -> None:
    done = subprocess.run(["ip", *arguments], capture_output=True, text=True, check=False)  # noqa: S607
    if done.returncode != 0:
        raise NetworkError(f"ip {' '.join(arguments)}: {done.stderr.strip() or done.returncode}")
