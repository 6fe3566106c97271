"""A bundle as a folder for any web host: the viewer's page, a manifest, and files named by their content.

Files are named by their CRC-32, so that hosts and browsers may cache them for ever; only ``index.html`` and
``manifest.json`` must be revalidated. Text and programs have a compressed copy for hosts that serve precompressed files
(nginx: ``gzip_static on``). Tiles, which are read by ranges, have none. Source frames are left out because players do
not need them. Layout: ``docs/bundle.md``.
"""

from __future__ import annotations

import gzip
import json
import shutil
import zlib
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from cags_common.bundle.manifest import MAX_MANIFEST_BYTES, Manifest
from cags_common.bundle.store import UrlStore
from cags_common.errors import ConfigError

MAX_BLOB_BYTES = 2**28
PAGE_SUFFIXES = {".html", ".js", ".css", ".svg", ".wasm"}
COMPRESSED_SUFFIXES = PAGE_SUFFIXES | {".json"}

SOURCE_TAG = '<meta name="cags-source" content="./" />'
"""Tells the page that its scene is in the same folder, not behind a server's WebSocket."""


@dataclass(frozen=True)
class Published:
    """Summary of the files written."""

    folder: str
    files: int
    bytes: int
    page: bool
    """Whether the viewer's page is included; otherwise the folder is for a page elsewhere."""


def publish(url: str, folder: Path, page: Path | None) -> Published:
    """Copy the bundle at ``url`` to ``folder``, together with the built viewer from ``page`` (None: without a viewer).

    Raises :class:`ConfigError` if ``folder`` is not empty, and :class:`cags_common.errors.BundleError` if ``url`` holds
    no bundle.
    """
    if folder.exists() and any(folder.iterdir()):
        raise ConfigError(f"publish = {folder}: is not empty; give an empty or a new folder")
    folder.mkdir(parents=True, exist_ok=True)
    store = UrlStore(url)
    data = store.read_all("manifest.json", MAX_MANIFEST_BYTES)
    Manifest.from_json(data)
    table: dict[str, Any] = json.loads(data)
    for group in table["gofs"]:
        tiles = group["tiles"]
        tiles["name"] = _named(store.read(tiles["name"], 0, tiles["size_bytes"]), "gof", folder)
        group["source"] = tiles
    table["published"] = {"codebooks": _named(store.read_all("codebooks.bin", MAX_BLOB_BYTES), "codebooks", folder)}
    if page is not None:
        _copy_page(page, folder)
    (folder / "manifest.json").write_text(json.dumps(table, separators=(",", ":"), sort_keys=True))
    _compress(folder)
    written = [path for path in folder.rglob("*") if path.is_file()]
    return Published(str(folder), len(written), sum(path.stat().st_size for path in written), page is not None)


def _named(data: bytes, kind: str, folder: Path) -> str:
    """Write ``data`` to a file named by its content, and return the name."""
    name = f"{kind}-{zlib.crc32(data):08x}-{len(data):x}.bin"
    (folder / name).write_bytes(data)
    return name


def _compress(folder: Path) -> None:
    """Write NAME.gz for every compressible file; equal files give equal bytes."""
    for path in sorted(folder.iterdir()):
        if path.suffix in COMPRESSED_SUFFIXES:
            path.with_name(f"{path.name}.gz").write_bytes(gzip.compress(path.read_bytes(), 9, mtime=0))


def built_page() -> Path | None:
    """The folder of the built viewer; None if it is not built or not installed."""
    try:
        folder = import_module("cags_web").page_folder()
    except ImportError:
        return None
    return None if folder is None else Path(folder)


def _copy_page(page: Path, folder: Path) -> None:
    """Copy the page's files; its HTML gets the tag that names the scene."""
    for path in sorted(page.iterdir()):
        if path.is_file() and path.suffix in PAGE_SUFFIXES and not path.name.startswith("gallery."):
            shutil.copyfile(path, folder / path.name)
    index = folder / "index.html"
    index.write_text(
        index.read_text(encoding="utf-8").replace("<head>", f"<head>\n    {SOURCE_TAG}", 1), encoding="utf-8"
    )
