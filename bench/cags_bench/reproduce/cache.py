"""Results kept by content: an interrupted run goes on where it stopped, and a change of the code starts afresh."""

from __future__ import annotations

import functools
import hashlib
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from cags_bench.bundles import default_cache
from cags_bench.jsonl import JsonObject, dump, provenance
from cags_common.files import write_whole

PACKAGES = (
    "cags_common",
    "cags_protocol",
    "cags_encoder",
    "cags_server",
    "cags_client",
    "cags_shaper",
    "cags_kernels",
    "cags_gpu",
    "cags_research",
    "cags_bench.sim",
    "cags_bench.film",
)
"""All that a simulated session runs, and what measures its film."""

SOURCES = (".py", ".so", ".npz")


@functools.cache
def code_digest() -> str:
    """Digest of all the code that a result depends on, native libraries and weights included."""
    from importlib.util import find_spec

    digest = hashlib.sha256()
    for name in PACKAGES:
        spec = find_spec(name)
        if spec is None or not spec.submodule_search_locations:
            continue
        root = Path(spec.submodule_search_locations[0])
        for path in sorted(p for p in root.rglob("*") if p.suffix in SOURCES):
            digest.update(str(path.relative_to(root)).encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def content_of(spec: str) -> str:
    """What a key says of an input: the digest of a file, or the words themselves where they name none."""
    path = Path(spec)
    if not spec or not path.is_file():
        return spec
    return hashlib.sha256(path.read_bytes()).hexdigest()[:32]


class ResultCache:
    """JSON results in files named by a digest of what they depend on."""

    def __init__(self, folder: Path | None = None) -> None:
        self.folder = folder or default_cache().with_name("results")

    def holds(self, key: JsonObject) -> bool:
        """Whether the result for ``key`` is there."""
        return self._path(key).exists()

    def get(self, key: JsonObject, compute: Callable[[], JsonObject]) -> JsonObject:
        """The result for ``key``, computed now unless it was before by the same code."""
        path = self._path(key)
        if path.exists():
            found: JsonObject = json.loads(path.read_text(encoding="utf-8"))["result"]
            return found
        began = time.process_time()
        result: dict[str, Any] = json.loads(dump(compute()))
        spent = {"cpu_s": round(time.process_time() - began, 1), "machine": provenance()["machine"]}
        self.folder.mkdir(parents=True, exist_ok=True)
        write_whole(path, dump({"key": key, "result": result, **spent}).encode())
        return result

    def cpu_s(self, key: JsonObject) -> float:
        """Processor seconds that the kept result for ``key`` took, on whichever machine computed it."""
        return float(json.loads(self._path(key).read_text(encoding="utf-8")).get("cpu_s", 0.0))

    def _path(self, key: JsonObject) -> Path:
        name = hashlib.sha256(dump({"code": code_digest(), **key}).encode()).hexdigest()[:32]
        return self.folder / f"{name}.json"
