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

PACKAGES = ("cags_common", "cags_protocol", "cags_encoder", "cags_server", "cags_client", "cags_shaper", "cags_kernels")


@functools.cache
def code_digest() -> str:
    """Digest of all the code that a result depends on, native libraries included."""
    from importlib.util import find_spec

    digest = hashlib.sha256()
    for name in PACKAGES:
        spec = find_spec(name)
        if spec is None or not spec.submodule_search_locations:
            continue
        root = Path(spec.submodule_search_locations[0])
        for path in sorted(p for p in root.rglob("*") if p.suffix in (".py", ".so", ".npz")):
            digest.update(str(path.relative_to(root)).encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


class ResultCache:
    """JSON results in files named by a digest of what they depend on."""

    def __init__(self, folder: Path | None = None) -> None:
        self.folder = folder or default_cache().with_name("results")

    def get(self, key: JsonObject, compute: Callable[[], JsonObject]) -> JsonObject:
        """The result for ``key``, computed now unless it was before by the same code."""
        name = hashlib.sha256(dump({"code": code_digest(), **key}).encode()).hexdigest()[:32]
        path = self.folder / f"{name}.json"
        if path.exists():
            found: JsonObject = json.loads(path.read_text(encoding="utf-8"))["result"]
            return found
        result: dict[str, Any] = json.loads(dump(compute()))
        self.folder.mkdir(parents=True, exist_ok=True)
        partial = path.with_suffix(".partial")
        partial.write_text(dump({"key": key, "result": result}), encoding="utf-8")
        partial.replace(path)
        return result
