"""Who hands the page out: nginx with a published folder, or the server with its bundle; and the link in front of it."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from cags_bench.demo.processes import ProcessGroup
from cags_common.errors import ConfigError, NetworkError

START_TIMEOUT_S = 20.0

NGINX = """\
{user}
daemon off;
worker_processes 1;
pid {work}/nginx.pid;
error_log stderr warn;
events {{ worker_connections 256; }}
http {{
  include /etc/nginx/mime.types;
  access_log {work}/access.log;
  client_body_temp_path {work}/body;
  proxy_temp_path {work}/proxy;
  fastcgi_temp_path {work}/fastcgi;
  uwsgi_temp_path {work}/uwsgi;
  scgi_temp_path {work}/scgi;
  gzip_static on;
  server {{
    listen 127.0.0.1:{port};
    root {folder};
  }}
}}
"""
"""As a distribution ships it, but for the folder, the port and ``gzip_static`` (``docs/how-to/operate.md``)."""


def free_port() -> int:
    """A TCP port of this machine that nobody listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@contextmanager
def nginx(folder: Path, work: Path) -> Iterator[int]:
    """A web host of ``folder`` that knows nothing of scenes; its port. ``work`` gets its log.

    Raises :class:`ConfigError` without nginx, and :class:`NetworkError` where it does not start.
    """
    program = shutil.which("nginx") or shutil.which("nginx", path="/usr/sbin:/usr/local/sbin")
    if program is None:
        raise ConfigError("no nginx here; apt-get install nginx-light")
    work.mkdir(parents=True, exist_ok=True)
    port = free_port()
    config = work / "nginx.conf"
    user = "user root;" if os.geteuid() == 0 else ""  # its workers are to read what we can
    text = NGINX.format(work=work.resolve(), folder=folder.resolve(), port=port, user=user)
    config.write_text(text, encoding="utf-8")
    with (work / "error.log").open("w") as log:
        running = subprocess.Popen([program, "-p", str(work), "-c", str(config.resolve())], stderr=log)
    try:
        _wait(port, running, work / "error.log")
        yield port
    finally:
        running.terminate()
        running.wait()


def _wait(port: int, running: subprocess.Popen[bytes], log: Path) -> None:
    ends = time.monotonic() + START_TIMEOUT_S
    while True:
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", port)) == 0:
                return
        if running.poll() is not None or time.monotonic() > ends:
            raise NetworkError(f"nginx did not start: {log.read_text().strip()[-300:] or 'no message'}")
        time.sleep(0.05)


@contextmanager
def server(bundle: Path, work: Path, *arguments: str) -> Iterator[int]:
    """The project's server of ``bundle``; its port."""
    work.mkdir(parents=True, exist_ok=True)
    with ProcessGroup(work) as group:
        started = group.start("cags_server", ["--bundle", str(bundle), "--port", "0", "--json", *arguments])
        yield int(started.ready()["port"])


@contextmanager
def link(trace: str, port: int, work: Path) -> Iterator[int]:
    """The shaper in front of ``port``; its own port. Traces begin with the process: a browser has many connections."""
    work.mkdir(parents=True, exist_ok=True)
    with ProcessGroup(work) as group:
        ends = ["--listen", "127.0.0.1:0", "--to", f"127.0.0.1:{port}", "--json"]
        started = group.start("cags_shaper", [*ends, "--trace", trace, "--delay-ms", "10", "--start", "process"])
        yield int(started.ready()["port"])
