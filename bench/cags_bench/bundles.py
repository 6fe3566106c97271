"""Encoded bundles, made once and found again by content."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cags_encoder import EncodeSettings


def default_cache() -> Path:
    """``$XDG_CACHE_HOME/cags-stream/bundles``, or the same under ``~/.cache``."""
    root = os.environ.get("XDG_CACHE_HOME") or str(Path("~/.cache").expanduser())
    return Path(root) / "cags-stream" / "bundles"


def cached_bundle(scene: str, cache: str = "", settings: EncodeSettings | None = None) -> Path:
    """Folder of the bundle of ``scene``, encoded now unless the same scene and settings were encoded before."""
    from cags_encoder.progress import terminal_progress

    from cags_encoder import EncodeSettings, content_key, encode, open_scene

    settings = settings or EncodeSettings()
    folder = Path(cache) if cache else default_cache()
    bundle = folder / content_key(scene, settings)
    if not (bundle / "manifest.json").exists():
        folder.mkdir(parents=True, exist_ok=True)
        with terminal_progress() as progress:
            encode(open_scene(scene), settings, str(bundle), progress=progress)
    return bundle
