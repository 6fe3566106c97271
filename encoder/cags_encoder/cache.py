"""A key for caching bundles: equal keys mean equal input, settings and encoder."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

from cags_common.bundle.store import local_path
from cags_encoder.settings import EncodeSettings

ENCODER_VERSION = 26
"""Increased whenever the same input gives other bytes."""


def content_key(scene_spec: str, settings: EncodeSettings) -> str:
    """A short hexadecimal key of the scene's spec, its files' names, sizes and modification times, and the settings."""
    digest = hashlib.sha256(repr((ENCODER_VERSION, scene_spec, sorted(asdict(settings).items()))).encode())
    for path in _files(scene_spec):
        status = path.stat()
        digest.update(repr((path.name, status.st_size, status.st_mtime_ns)).encode())
    return digest.hexdigest()[:16]


def resume_folder(out_url: str, key: str) -> Path:
    """Folder of the records of a run that writes ``out_url``: beside a local bundle, otherwise in the user's cache."""
    local = local_path(out_url)
    if local is not None:
        return local.parent / f".{local.name}.encoding"
    root = os.environ.get("XDG_CACHE_HOME") or str(Path("~/.cache").expanduser())
    return Path(root) / "cags-stream" / "encoding" / key


def _files(scene_spec: str) -> Iterator[Path]:
    """Files named by a spec such as ``motion:PATH:options``: those of the longest existing path in it."""
    parts = scene_spec.split(":")
    for length in range(len(parts), 0, -1):
        for first in range(len(parts) - length + 1):
            text = ":".join(parts[first : first + length])
            path = Path(text)
            if text and path.exists():
                yield from sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]
                return
