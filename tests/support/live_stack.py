"""Server, shaper and client with a live page, as processes on free ports."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from cags_bench.demo.processes import ProcessGroup


@contextmanager
def live_stack(
    scene: str,
    folder: Path,
    *,
    width: int,
    height: int,
    delay_ms: float = 10.0,
    trace: str = "generated:steady-30",
    more: Sequence[str] = (),
    server: Sequence[str] = (),
) -> Iterator[str]:
    """Encode ``scene`` into ``folder`` and stream it; ``more`` and ``server`` are flags of client and server.

    Yields the page's address.
    """
    bundle = folder / "clip.cags"
    encode = [sys.executable, "-m", "cags_encoder", scene, str(bundle)]
    subprocess.run(encode, check=True, capture_output=True)
    with ProcessGroup(folder) as group:
        port = group.start("cags_server", ["--bundle", str(bundle), "--port", "0", "--json", *server]).ready()["port"]
        link = ["--listen", "127.0.0.1:0", "--to", f"127.0.0.1:{port}", "--control", "127.0.0.1:0", "--json"]
        shaping = ["--trace", trace, "--delay-ms", str(delay_ms)]
        shaper = group.start("cags_shaper", [*link, *shaping]).ready()
        view = ["--view", "--view-port", "0", "--shaper-control", f"127.0.0.1:{shaper['control']}", "--json", "-"]
        url = f"ws://127.0.0.1:{shaper['port']}/stream"
        size = ["--width", str(width), "--height", str(height)]
        client = group.start("cags_client", ["--url", url, *size, "--truth", str(bundle), *view, *more]).ready()
        yield str(client["url"])
