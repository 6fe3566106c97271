"""The same play in real time, as three processes with the shaper, and in virtual time."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from cags_bench.demo.processes import ProcessGroup
from cags_bench.sim.session import Scenario, simulate
from cags_bench.traces import link_share, scaled_trace
from cags_common.errors import NetworkError

TRACES = ("generated:steady-30", "generated:lte-driving", "generated:step")
CLIENT_TIMEOUT_S = 300.0
TRACE_S = 60.0


def realtime_lines(base: Scenario, like_splats: int, traces: tuple[str, ...] = TRACES) -> Iterator[dict[str, Any]]:
    """One line per trace: bytes that arrived in real and in virtual time.

    Links are scaled as in the content part, so that they limit what is sent. In virtual time, pictures are drawn
    without references because they are not scored; both plays request the same references.
    """
    share = link_share(base.bundle, like_splats)
    base = replace(base, scored=False)
    for spec in traces:
        scenario = replace(base, trace=str(scaled_trace(spec, share, seconds=TRACE_S)))
        virtual, real = simulate(scenario).summary, play(scenario)
        totals = [float(s["bytes_tiles"] + s["bytes_reference"]) for s in (real, virtual)]
        yield {
            "case": "realtime",
            "trace": spec,
            "share": share,
            "real_bytes": totals[0],
            "virtual_bytes": totals[1],
            "difference": abs(totals[0] - totals[1]) / max(totals[1], 1.0),
            "frames_missed": real["frames_missed"],
            "frames_dropped": real["frames_dropped"],
        }


def play(scenario: Scenario) -> dict[str, Any]:
    """The client's summary of one play in real time."""
    client = scenario.client
    with tempfile.TemporaryDirectory(prefix="cags-network-") as folder, ProcessGroup(Path(folder)) as group:
        server = group.start(
            "cags_server", ["--bundle", str(scenario.bundle), "--port", "0", "--abr", scenario.server.abr, "--json"]
        ).ready()
        shaper = group.start(
            "cags_shaper",
            [
                *("--listen", "127.0.0.1:0", "--to", f"127.0.0.1:{server['port']}", "--json"),
                *("--trace", scenario.trace, "--delay-ms", str(scenario.delay_us / 1000)),
            ],
        ).ready()
        report = Path(folder) / "frames.jsonl"
        process = group.start(
            "cags_client",
            [
                *("--url", f"ws://127.0.0.1:{shaper['port']}/stream", "--poses", scenario.poses, "--json", str(report)),
                *("--width", str(client.width), "--height", str(client.height), "--restore", client.restore),
            ],
        )
        process.handle.communicate(timeout=CLIENT_TIMEOUT_S)
        if process.handle.returncode != 0:
            raise NetworkError(f"cags-client failed: {process.last_words()}")
        return dict(json.loads(report.read_text(encoding="utf-8").splitlines()[-1]))
