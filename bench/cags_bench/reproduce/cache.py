"""Results kept by content: an interrupted run goes on where it stopped, and a change of the code starts afresh."""

from __future__ import annotations

import functools
import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from cags_bench.bundles import default_cache
from cags_bench.jsonl import JsonObject, dump
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
        result: dict[str, Any] = json.loads(dump(compute()))
        self.folder.mkdir(parents=True, exist_ok=True)
        write_whole(path, dump({"key": key, "result": result}).encode())
        return result

    def _path(self, key: JsonObject) -> Path:
        name = hashlib.sha256(dump({"code": code_digest(), **key}).encode()).hexdigest()[:32]
        return self.folder / f"{name}.json"
