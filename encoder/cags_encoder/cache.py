"""A key for caching bundles: equal keys mean equal input, settings and encoder."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

from cags_common.bundle.store import written_folder
from cags_common.bundle.view import read_view
from cags_encoder.codecs.lod_order import NAMED_ORDERS, order_in_file
from cags_encoder.formats.registry import META
from cags_encoder.scenes.files import exists
from cags_encoder.scenes.folders import frame_of_folder, numbered_frames
from cags_encoder.scenes.open import GENERATED, MOTION
from cags_encoder.scenes.options import split_options
from cags_encoder.settings import EncodeSettings

ENCODER_VERSION = 56
"""Increased whenever the same input gives other bytes."""


def content_key(scene_spec: str, settings: EncodeSettings) -> str:
    """A short hexadecimal key of the scene's spec, its files' names, sizes and modification times, and the settings.

    Only files that the scene reads count, and of the files that settings name, their content. Raises
    :class:`ConfigError` or :class:`SceneError` where these cannot be read.
    """
    digest = hashlib.sha256(repr((ENCODER_VERSION, scene_spec, sorted(_resolved(settings).items()))).encode())
    path = _path_of(scene_spec)
    for file in sorted(_files(path)) if path is not None and exists(path) else ():
        status = file.stat()
        digest.update(repr((file.name, status.st_size, status.st_mtime_ns)).encode())
    return digest.hexdigest()[:16]


def resume_folder(out_url: str, key: str) -> Path:
    """Folder of the records of a run that writes ``out_url``: beside a local bundle, otherwise in the user's cache."""
    local = written_folder(out_url)
    if local is not None:
        return local.parent / f".{local.name}.encoding"
    root = os.environ.get("XDG_CACHE_HOME") or str(Path("~/.cache").expanduser())
    return Path(root) / "cags-stream" / "encoding" / key


def _resolved(settings: EncodeSettings) -> dict[str, Any]:
    """The settings, with the content of files in place of their names."""
    table = asdict(settings)
    if settings.lod_order not in NAMED_ORDERS:
        table["lod_order"] = _content(settings.lod_order, order_in_file)
    if settings.view:
        table["view"] = _content(settings.view, read_view)
    return table


def _content(name: str, read: Callable[[str], Any]) -> Any:
    """What the file says; for a pipe, whose content is left to the encoder as it can be read only once, which it is."""
    path = Path(name)
    return path.stat().st_ino if path.is_fifo() else read(name)


def _path_of(spec: str) -> Path | None:
    """The file or folder that :func:`~cags_encoder.scenes.open_scene` finds in a spec; None for generated scenes."""
    spec = spec.removeprefix(MOTION)
    head, _ = split_options(spec)
    if not head or head in GENERATED:
        return None
    return Path(spec if exists(Path(spec)) else head)


def _files(path: Path) -> Iterator[Path]:
    """Files that the scene at ``path`` reads: not what else lies in its folder, such as the bundle in the making."""
    if path.name == META:
        path = path.parent
    if path.is_file():
        yield path
        return
    single = frame_of_folder(path)
    for frame in [single] if single else numbered_frames(path):
        if frame.is_dir():  # an unbundled SOG: its images lie beside one another
            yield from (file for file in frame.iterdir() if file.is_file() and not file.name.startswith("."))
        else:
            yield frame
