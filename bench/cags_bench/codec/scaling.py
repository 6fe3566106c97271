"""Speed-up of encoding a clip with several processes, and a check that its bytes stay the same."""

from __future__ import annotations

import hashlib
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from cags_encoder import EncodeSettings, encode
from cags_encoder.execution.executors import open_workers
from cags_encoder.scenes import open_scene

Line = dict[str, Any]


def scaling(clip: str, frames: int, workers: Sequence[int]) -> Iterator[Line]:
    """One line per number of ``workers``: seconds by stage, and a hash of the bundle.

    The start of the processes is excluded, because it does not matter for a long clip.
    """
    for count in workers:
        with tempfile.TemporaryDirectory(prefix="cags-codec-") as folder, open_workers(count) as pool:
            pool.executor.submit(open_scene, clip).result()
            stages, started = _Stages(), time.perf_counter()
            manifest = encode(open_scene(clip), EncodeSettings(frames=frames), f"{folder}/out", stages, workers=pool)
            yield {
                "clip": clip,
                "workers": count,
                "frames": manifest.frames,
                "total_s": time.perf_counter() - started,
                "stages_s": stages.seconds,
                "sha256": _hash(Path(folder) / "out"),
            }


class _Stages:
    """Seconds per stage, from the progress reports of an encoder; the stages run one after another."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._at = time.perf_counter()

    def __call__(self, stage: str, done: int, total: int) -> None:
        now = time.perf_counter()
        self.seconds[stage] = self.seconds.get(stage, 0.0) + now - self._at
        self._at = now


def _hash(folder: Path) -> str:
    whole = hashlib.sha256()
    for path in sorted(path for path in folder.rglob("*") if path.is_file()):
        whole.update(str(path.relative_to(folder)).encode() + path.read_bytes())
    return whole.hexdigest()
