"""Every parser and both sessions under damage, at length: ``python tests/fuzz.py --messages 1000000 --cases 100000``.

What the nightly tests do, as one command with counts: a JSON line a target with its cases, how many were still read,
processor time and the largest resident memory so far. What a target may not do ends that target with its seed's error
and the command with exit status 1; the others go on.
"""

from __future__ import annotations

import argparse
import json
import resource
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

from property.client import test_hostile_page as page
from property.common.bundle import test_hostile_bundles as bundles
from property.common.motion import test_hostile_chunks as chunks
from property.common.tiles import test_payload_properties as payloads
from property.common.video import test_h264_hostile as video
from property.encoder.formats import test_hostile_files as files
from property.encoder.formats import test_hostile_npz as npz
from property.encoder.formats import test_hostile_timed as timed
from property.protocol import test_fuzz as sessions
from property.research import test_baseline_payloads as baselines
from property.shaper import test_hostile_traces as traces

Fuzz = Callable[[int, int], int]
"""Given cases and a seed: how many were read, or closed a session."""

MESSAGES = "messages to sessions"


def targets(folder: Path) -> Iterator[tuple[str, Fuzz]]:
    """Name and fuzz of every target; ``folder`` holds files while they are read."""
    yield MESSAGES, sessions.fuzz
    for name in files.PARSERS:
        yield f"scene {name}", partial(files.fuzz, name)
    for name in timed.PARSERS:
        yield f"scene {name}", partial(timed.fuzz, name)
    yield "scene npz", partial(npz.fuzz, folder)
    for name in payloads.PARSERS:
        yield f"payload {name}", partial(payloads.fuzz, name)
    for name in baselines.CODECS:
        yield f"payload {name}", partial(baselines.fuzz, name)
    yield "payload motion", partial(chunks.fuzz, native=True)
    yield "payload h264", video.fuzz
    yield "page message", page.fuzz
    for name in traces.READERS:
        yield f"trace {name}", partial(traces.fuzz, folder, name)
    yield "bundle", bundles.fuzz


def main(arguments: list[str] | None = None) -> int:
    """Run the targets that are asked for; 1 where one of them did what it may not."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--messages", type=int, default=1_000_000, help="wrong messages to sessions")
    parser.add_argument("--cases", type=int, default=100_000, help="damaged inputs a parser")
    parser.add_argument("--seed", type=int, default=2, help="another seed, other damage")
    parser.add_argument("--only", default="", help="targets whose name holds this word")
    options = parser.parse_args(arguments)
    failed = False
    with tempfile.TemporaryDirectory(prefix="cags-fuzz-") as folder:
        for name, fuzz in targets(Path(folder)):
            if options.only in name:
                line = run(name, fuzz, options.messages if name == MESSAGES else options.cases, options.seed)
                failed |= "error" in line
                print(json.dumps(line), flush=True)
    return int(failed)


def run(name: str, fuzz: Fuzz, cases: int, seed: int) -> dict[str, object]:
    """One target's line."""
    line: dict[str, object] = {"target": name, "cases": cases, "seed": seed}
    began = time.process_time()
    try:
        line["closed" if name == MESSAGES else "read"] = fuzz(cases, seed)
    except Exception as error:
        line["error"] = f"{type(error).__name__}: {error}"
        traceback.print_exc()
    line["cpu_s"] = round(time.process_time() - began, 1)
    line["max_rss_mb"] = round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3)
    return line


if __name__ == "__main__":
    sys.exit(main())
