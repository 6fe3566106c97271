"""An earlier state to compare with: the same cases played by an earlier installation, or read from an earlier run."""

from __future__ import annotations

import json
import subprocess
import tempfile
from pathlib import Path

from cags_bench.bundles import default_cache
from cags_bench.jsonl import JsonObject
from cags_bench.programs import executable
from cags_bench.references.cases import Case, figures_of
from cags_bench.references.methods import EARLIER, OURS
from cags_common.errors import ConfigError
from cags_server.settings import ServerSettings


def played_before(python: str, case: Case) -> JsonObject:
    """Play ``case`` with ``cags-bench stream`` of another installation (its ``python``), with its default restoration.

    If their bundle formats are equal, both use the same bundle and so send the same splats. Raises :class:`ConfigError`
    if the other installation cannot run.
    """
    server = ServerSettings()
    with tempfile.TemporaryDirectory(prefix="cags-before-") as out:
        command = [str(executable("before", python)), "-m", "cags_bench", "stream", "--json", "--out", out]
        options = {
            "scene": case.scene,
            "trace": case.trace(),
            "poses": case.poses,
            "frames": case.frames,
            "width": case.width,
            "height": case.height,
            "predictor": server.predictor,
            "fov-policy": server.fov,
            "abr": server.abr,
            "cache": case.cache or str(default_cache()),
        }
        for name, value in options.items():
            command += [f"--{name}", str(value)]
        finished = subprocess.run(command, capture_output=True, text=True, check=False)
        if finished.returncode:
            message = (finished.stderr.strip().splitlines() or ["nothing"])[-1]
            raise ConfigError(f"before = {python!r} cannot play {case.scene}; its message: {message}")
        last = json.loads(finished.stdout.splitlines()[-1])
        text = (Path(out) / "frames.jsonl").read_text(encoding="utf-8")
    frames = [json.loads(line) for line in text.splitlines()]
    return figures_of(frames, last) | {"before_commit": last.get("commit")}


def read_baseline(path: Path) -> list[JsonObject]:
    """Lines of an earlier run: those marked ``before``, or else those of its default method.

    Raises :class:`ConfigError` if the file has none.
    """
    try:
        lines = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines() if line.strip()]
    except (OSError, ValueError) as error:
        raise ConfigError(f"baseline = {str(path)!r} cannot be read: {error}") from error
    ours = [line for line in lines if line.get("benchmark") == "references" and not line.get("summary")]
    for method in (EARLIER, OURS):
        found = [line for line in ours if line["method"] == method]
        if found:
            return found
    raise ConfigError(
        f"baseline = {str(path)!r} contains no case to compare with; write one with "
        f"cags-bench references --methods {OURS} --json"
    )
