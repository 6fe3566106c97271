"""A web host of files that serves ranges, and may stop answering: it accepts, and says nothing."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import unquote


class RangeStore(ThreadingHTTPServer):
    """Serves ``folder``. Requests that come while it is silent are answered when it speaks again."""

    daemon_threads = True

    def __init__(self, folder: Path) -> None:
        super().__init__(("127.0.0.1", 0), _Handler)
        self.folder, self.requests = folder, 0
        self.hushed = ""
        """Text in the paths that are not answered while :attr:`speaks` is not set."""
        self.speaks = threading.Event()
        self.speaks.set()

    @property
    def url(self) -> str:
        """Where the folder is."""
        return f"http://127.0.0.1:{self.server_port}"

    def handle_error(self, request: object, client_address: object) -> None:
        """Whoever asked has gone."""


class _Handler(BaseHTTPRequestHandler):
    server: RangeStore
    protocol_version = "HTTP/1.1"

    def do_HEAD(self) -> None:
        self._answer(body=False)

    def do_GET(self) -> None:
        self._answer(body=True)

    def _answer(self, *, body: bool) -> None:
        self.server.requests += 1
        if self.server.hushed in self.path:
            self.server.speaks.wait()
        file = self.server.folder / unquote(self.path).lstrip("/")
        if not file.is_file():
            self.send_error(404)
            return
        self._send(file, body=body)

    def _send(self, file: Path, *, body: bool) -> None:
        data, wanted = file.read_bytes(), self.headers.get("Range")
        if wanted is not None:
            first, last = wanted.removeprefix("bytes=").split("-")
            data = data[int(first) : int(last) + 1 if last else None]
        self.send_response(200 if wanted is None else 206)
        self.send_header("Content-Length", str(len(data)))
        self.send_header("Accept-Ranges", "bytes")
        self.end_headers()
        if body:
            self.wfile.write(data)

    def log_message(self, *arguments: object) -> None:
        """Nothing."""


@contextmanager
def range_store(folder: Path) -> Iterator[RangeStore]:
    """Serve ``folder`` until the block ends."""
    with RangeStore(folder) as store:
        thread = threading.Thread(target=store.serve_forever, args=(0.05,), daemon=True)
        thread.start()
        try:
            yield store
        finally:
            store.speaks.set()
            store.shutdown()
            thread.join()
