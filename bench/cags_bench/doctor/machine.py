"""Processor, memory, graphics card, network stack and ports."""

from __future__ import annotations

import contextlib
import errno
import http.client
import json
import os
import shutil
import socket
import sys
from collections.abc import Iterator
from pathlib import Path

from cags_bench.doctor.findings import Finding, fine, missing, note

OLDEST_PYTHON = (3, 11)
PORTS = {8765: "cags-server", 9000: "cags-shaper", 8080: "the live page"}
PORT_FLAGS = {"cags-server": "--port 0", "cags-shaper": "--listen 127.0.0.1:0", "the live page": "--view-port 0"}
BUSY_SHARE = 0.5
PROBE_S, PROBE_BYTES = 1.0, 2_000
LEAST_MEMORY_GIB = 2.0
LEAST_DISK_GIB = 2.0
VECTOR_FLAGS = ("avx512f", "avx2", "asimd")


def machine_findings(cache: Path) -> Iterator[Finding]:
    """All checks that need no package of this project. ``cache`` is the folder of cached bundles."""
    yield python_version(sys.version_info[:2])
    yield cores(usable_cores())
    yield load(os.getloadavg()[0] if hasattr(os, "getloadavg") else 0.0, usable_cores())
    yield vectors(read_text(Path("/proc/cpuinfo")))
    yield memory(read_text(Path("/proc/meminfo")))
    yield disk(cache)
    yield congestion_control(read_text(Path("/proc/sys/net/ipv4/tcp_congestion_control")))
    for port, purpose in PORTS.items():
        yield free_port(port, purpose)
    yield browser(shutil.which("chromium") or shutil.which("google-chrome") or shutil.which("firefox"))


def usable_cores() -> int:
    """Number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def python_version(version: tuple[int, int]) -> Finding:
    """Whether the interpreter is recent enough."""
    text = ".".join(map(str, version))
    if version < OLDEST_PYTHON:
        return missing("Python", text, "install Python 3.11 or newer and create the environment again")
    return fine("Python", text)


def cores(count: int) -> Finding:
    """Number of cores, which server and client share if both run here."""
    if count < 2:
        return note("cores", "1", "server and client on one core will miss frames; give them 2 or shrink the picture")
    return fine("cores", str(count))


def load(average: float, count: int) -> Finding:
    """Load by other programs, which makes timings unreliable."""
    found = f"{average:.1f} threads running or waiting for {count} cores, mean of the last minute"
    if average > BUSY_SHARE * count:
        return note("load", found, "timings under load are too long; run cags-doctor again when the machine is idle")
    return fine("load", found)


def vectors(cpuinfo: str) -> Finding:
    """The widest vector instructions that the kernels can use."""
    flags = set(cpuinfo.split())
    widest = next((flag for flag in VECTOR_FLAGS if flag in flags), None)
    if widest is None:
        return note("SIMD", "none known", "the portable kernels run, several times slower than with AVX2")
    return fine("SIMD", widest.upper())


def memory(meminfo: str) -> Finding:
    """Available memory."""
    fields = dict(line.split(":", 1) for line in meminfo.splitlines() if ":" in line)
    try:
        gib = int(fields["MemAvailable"].split()[0]) / 2**20
    except (KeyError, ValueError, IndexError):
        return note("memory", "unknown", "this system does not report it; large scenes need a few GiB")
    if gib < LEAST_MEMORY_GIB:
        return note("memory", f"{gib:.1f} GiB free", f"close other programs: encoding needs {LEAST_MEMORY_GIB:.0f} GiB")
    return fine("memory", f"{gib:.1f} GiB free")


def disk(cache: Path) -> Finding:
    """Free space in the folder of cached bundles."""
    there = next(path for path in (cache, *cache.parents) if path.exists())
    gib = shutil.disk_usage(there).free / 2**30
    found = f"{gib:.1f} GiB free at {cache}"
    if not os.access(there, os.W_OK):
        return missing("disk", f"{there} cannot be written", "choose another folder with XDG_CACHE_HOME or --cache")
    if gib < LEAST_DISK_GIB:
        return note(
            "disk", found, f"a bundle with its source frames may take {LEAST_DISK_GIB:.0f} GiB; clear the cache"
        )
    return fine("disk", found)


def congestion_control(name: str) -> Finding:
    """TCP's congestion control. The credit window keeps queues short with any algorithm, and shortest with bbr."""
    name = name.strip()
    if not name:
        return note("congestion control", "unknown", "not Linux: latency under load was measured on Linux only")
    if name != "bbr":
        return note("congestion control", name, "bbr keeps queues shorter: sysctl net.ipv4.tcp_congestion_control=bbr")
    return fine("congestion control", name)


def free_port(port: int, purpose: str) -> Finding:
    """Whether a command's default port is free, or used by a command of this project."""
    matter = f"port {port}"
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", port))
        except OSError as error:
            if error.errno == errno.EADDRINUSE and is_ours(port):
                return fine(matter, f"used by cags-stream (default of {purpose})")
            reason = "in use by another program" if error.errno == errno.EADDRINUSE else str(error.strerror)
            remedy = f"end that program, or choose another port for {purpose}: {PORT_FLAGS[purpose]}"
            return missing(matter, f"{reason} (default of {purpose})", remedy)
    return fine(matter, f"free for {purpose}")


def is_ours(port: int) -> bool:
    """Whether a server (directly or through a shaper) or a client's page answers on a port of this machine."""
    try:
        health, page = asked(port, "/healthz"), asked(port, "/")
        with contextlib.suppress(ValueError):
            return isinstance(json.loads(health).get("status"), str)
    except (OSError, http.client.HTTPException, AttributeError):
        return False
    return b"<title>cags-stream" in page


def asked(port: int, path: str) -> bytes:
    """The first bytes of a local port's answer to a request."""
    line = http.client.HTTPConnection("127.0.0.1", port, timeout=PROBE_S)
    try:
        line.request("GET", path)
        return line.getresponse().read(PROBE_BYTES)
    finally:
        line.close()


def browser(path: str | None) -> Finding:
    """A browser for the live page on this machine."""
    if path is None:
        return note("browser", "none found", "the live page can be opened from another machine: --view-host 0.0.0.0")
    return fine("browser", path)


def read_text(path: Path) -> str:
    """The file's text; empty if it cannot be read."""
    try:
        return path.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""
