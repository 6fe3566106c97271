"""A bundle as a folder for any web host: the viewer's page, a manifest, and files named by their content.

Files are named by their CRC-32, so that hosts and browsers may cache them for ever; only ``index.html`` and
``manifest.json`` must be revalidated. Text and programs have a compressed copy for hosts that serve precompressed files
(nginx: ``gzip_static on``). Tiles, which are read by ranges, have none. Source frames are left out because players do
not need them. Layout: ``docs/bundle.md``.
"""

from __future__ import annotations

import gzip
import json
import os
import shutil
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from cags_common.bundle.manifest import MAX_MANIFEST_BYTES, Manifest
from cags_common.bundle.reader import naming, refuse_published
from cags_common.bundle.store import UrlStore, remove_tree, written_folder
from cags_common.errors import ConfigError, OutputError

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

    ``folder`` must be new or empty, outside of the bundle, and stays so if anything fails. Raises
    :class:`ConfigError` if it is not, :class:`OutputError` if it cannot be written, and
    :class:`cags_common.errors.BundleError` if ``url`` holds no whole bundle.
    """
    try:
        _check_folder(url, folder)
        store = UrlStore(url)
        data = store.read_all("manifest.json", MAX_MANIFEST_BYTES)
        with naming(url):
            Manifest.from_json(data)
            refuse_published(url, data)
        with _all_or_nothing(folder) as writing:
            _write(store, json.loads(data), page, writing)
        written = [path for path in folder.rglob("*") if path.is_file()]
        return Published(str(folder), len(written), sum(path.stat().st_size for path in written), page is not None)
    except OSError as error:
        raise OutputError.of(folder, error) from error


def _check_folder(url: str, folder: Path) -> None:
    bundle = written_folder(url)
    if bundle is not None and Path(os.path.realpath(folder)).is_relative_to(bundle):
        raise ConfigError(
            f"publish = {folder}: lies inside the bundle {url}, which could not be replaced any more; give a folder "
            "outside of it"
        )
    if folder.is_dir():
        if any(folder.iterdir()):
            raise ConfigError(f"publish = {folder}: is not empty; give an empty or a new folder")
    elif folder.exists():
        raise ConfigError(f"publish = {folder}: is a file; give an empty or a new folder")


@contextmanager
def _all_or_nothing(folder: Path) -> Iterator[Path]:
    """A temporary folder whose files are in ``folder`` at the end of the block, unless an error ends it.

    A new folder appears whole, by renaming. An empty one that is there may be a mount or a working directory, so it is
    kept, and the files are moved into it.
    """
    there = folder.is_dir()
    parent = folder if there else folder.parent
    parent.mkdir(parents=True, exist_ok=True)
    scratch = parent / f".{folder.name}.partial-{os.getpid()}"
    scratch.mkdir()
    try:
        yield scratch
        for path in scratch.iterdir() if there else ():
            path.rename(folder / path.name)
        if not there:
            scratch.rename(folder)
    finally:
        remove_tree(scratch)


def _write(store: UrlStore, table: dict[str, Any], page: Path | None, folder: Path) -> None:
    """Write the bundle in ``store``, whose manifest is ``table``, and the page."""
    for group in table["gofs"]:
        tiles = group["tiles"]
        tiles["name"] = _named(store.read(tiles["name"], 0, tiles["size_bytes"]), "gof", folder)
        group["source"] = tiles
    table["published"] = {"codebooks": _named(store.read_all("codebooks.bin", MAX_BLOB_BYTES), "codebooks", folder)}
    if page is not None:
        _copy_page(page, folder)
    (folder / "manifest.json").write_text(json.dumps(table, separators=(",", ":"), sort_keys=True))
    _compress(folder)


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
