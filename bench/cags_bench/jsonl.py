"""JSON lines of benchmarks: one line per case, and a last line that reports every target.

Every line has the provenance of the measurement (machine, commit, versions); the caller adds seed, warm-up,
repetitions, median and spread. Figures with a target are repeated in the last line as ``checks``.
"""

from __future__ import annotations

import functools
import json
import math
import os
import platform
import subprocess
import sys
from collections.abc import Iterable, Iterator
from importlib import metadata
from pathlib import Path
from typing import Any

JsonObject = dict[str, Any]

REPORTED_PACKAGES = ("numpy", "torch", "av", "DracoPy", "faiss-cpu")


@functools.cache
def provenance() -> JsonObject:
    """Machine, commit and versions; the same object for every line of a run."""
    return {
        "machine": f"{_cpu_model()} ({os.cpu_count()} cores), {platform.system()} {platform.machine()}",
        "commit": _commit(),
        "python": platform.python_version(),
        "versions": {name: _version(name) for name in REPORTED_PACKAGES},
    }


def check(name: str, target: str, value: object, ok: bool) -> JsonObject:
    """One target and the measured value. ``ok`` is only reported; it never changes an exit code."""
    return {"name": name, "target": target, "value": value, "ok": bool(ok)}


def summary(benchmark: str, checks: Iterable[JsonObject], **figures: Any) -> JsonObject:
    """The last line of a benchmark."""
    return {"summary": True, "benchmark": benchmark, **figures, "checks": list(checks), **provenance()}


def dump(line: JsonObject) -> str:
    """One JSON line with sorted keys; non-finite floats become null, because JSON has none."""
    return json.dumps(_finite(line), sort_keys=True, allow_nan=False)


def write_lines(lines: Iterable[JsonObject], stream: Any = None) -> Iterator[JsonObject]:
    """Print each line as it comes, and pass it on."""
    for line in lines:
        print(dump(line), file=stream or sys.stdout, flush=True)
        yield line


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    if hasattr(value, "item") and callable(value.item):  # numpy scalars
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _cpu_model() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or "unknown CPU"


def _commit() -> str:
    try:
        out = subprocess.run(
            ["git", "describe", "--always", "--dirty"],  # noqa: S607 - git is found on the path by intent
            cwd=Path(__file__).parent,
            capture_output=True,
            text=True,
            timeout=5,
            check=True,
        )
    except (OSError, subprocess.SubprocessError):
        return _version("cags-stream")
    return out.stdout.strip()


def _version(package: str) -> str:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "absent"
