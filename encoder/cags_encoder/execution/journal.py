"""Records of a run's finished frames, kept beside the bundle, from which a killed run continues when started again.

Each frame has one file, written atomically, with the packed content of the frame. The rest of the encoder's state is
rebuilt by reading and quantising the frames again. A journal belongs to one input, one set of settings and one set of
codebooks; if any differs, it starts afresh. It consists of plain arrays and JSON; nothing in it is evaluated.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import shutil
import zipfile
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import IO, Any

import numpy as np

from cags_common.bundle import TilePayloads
from cags_common.errors import BundleError
from cags_common.files import whole_file, write_whole
from cags_common.tiles.kinds import TileKind

ATTEMPTS = 20
"""How often a folder that other runs delete at the same moment is made again."""


@dataclass(frozen=True, eq=False)
class FrameRecord:
    """One finished frame."""

    tiles: tuple[TilePayloads, ...]
    source: bytes
    """Its unquantised changes, packed."""


class Journal:
    """Records of finished frames in ``folder``; a context manager. Only one process at a time can open it.

    ``key`` identifies the input and the settings. Raises :class:`BundleError` if another process has it open or the
    folder cannot be written.
    """

    def __init__(self, folder: Path, key: str) -> None:
        self._folder = folder
        try:
            self._lock = _locked(folder)
        except BlockingIOError as error:
            raise BundleError(f"{folder}: another process encodes this bundle; wait for it or stop it") from error
        except OSError as error:
            raise BundleError(
                f"{folder}: cannot be written ({error.strerror or error}); use --no-resume to keep no records"
            ) from error
        try:
            self._belongs_to("input", key)
        except BaseException:  # a full disk
            self._close()
            raise

    def __enter__(self) -> Journal:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._close()

    def _close(self) -> None:
        if self._folder.is_dir() and not any(self._folder.glob("*.npz")):
            shutil.rmtree(self._folder, ignore_errors=True)  # no finished frames
        self._lock.close()

    def codebooks(self, data: bytes) -> None:
        """Keep the records only if they were made with the codebooks ``data``."""
        self._belongs_to("codebooks", hashlib.sha256(data).hexdigest())

    def note(self, name: str) -> Any:
        """A JSON value stored by :meth:`write_note`, or None."""
        try:
            return json.loads((self._folder / f"{name}.json").read_bytes())
        except (OSError, ValueError):
            return None

    def write_note(self, name: str, value: Any) -> None:
        """Store a JSON value."""
        write_whole(self._folder / f"{name}.json", json.dumps(value).encode())

    def has(self, index: int) -> bool:
        """Whether a record of frame ``index`` exists; it may be damaged."""
        return (self._folder / _name(index)).is_file()

    def frame(self, index: int) -> FrameRecord | None:
        """The record of frame ``index``, or None if it does not exist or is damaged."""
        try:
            with (self._folder / _name(index)).open("rb") as file, np.load(file, allow_pickle=False) as arrays:
                return _record(dict(arrays))
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
            return None

    def add(self, index: int, record: FrameRecord) -> None:
        """Store the record of frame ``index``. Raises :class:`OutputError` if the disk is full."""
        with whole_file(self._folder / _name(index)) as writing, writing.open("wb") as file:
            np.savez(file, **_arrays(record))

    def discard(self) -> None:
        """Delete everything: the bundle is complete, or the run cannot be continued."""
        shutil.rmtree(self._folder, ignore_errors=True)
        self._lock.close()

    def _belongs_to(self, kind: str, key: str) -> None:
        """Drop all records and notes unless they were made for ``key``."""
        path = self._folder / f"{kind}.key"
        if path.is_file() and path.read_text() == key:
            return
        for old in self._folder.iterdir():
            if old.suffix in (".npz", ".json"):
                old.unlink()
        write_whole(path, key.encode())


def _locked(folder: Path) -> IO[str]:
    """The locked file of ``folder``, which is made if it is missing.

    A run that ends just now deletes the folder; what was opened in it before is not what others will lock. Raises
    :class:`BlockingIOError` if another process holds the lock, and :class:`OSError` where nothing can be written.
    """
    for _ in range(ATTEMPTS):
        folder.mkdir(parents=True, exist_ok=True)
        with ExitStack() as stack, suppress(FileNotFoundError):
            lock = stack.enter_context((folder / "lock").open("w"))
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if os.path.samestat(os.fstat(lock.fileno()), (folder / "lock").stat()):
                stack.pop_all()
                return lock
    raise BlockingIOError


def _name(index: int) -> str:
    return f"frame_{index:06d}.npz"


def _arrays(record: FrameRecord) -> dict[str, Any]:
    tiles = record.tiles
    sizes = [[len(payload) for payload in tile.payloads] for tile in tiles]
    arrays: dict[str, Any] = {
        "source": np.frombuffer(record.source, np.uint8),
        "splats": np.array([tile.splats for tile in tiles], np.int64),
        "first_ids": np.array([-1 if tile.first_id is None else tile.first_id for tile in tiles], np.int64),
        "bounds": np.array([tile.bounds for tile in tiles], np.float64).reshape(-1, 2, 3),
        "kinds": np.array([(int(t.kind), *(t.looks or (0, 0)), t.span) for t in tiles], np.int64).reshape(-1, 4),
        "sizes": np.array([size for each in sizes for size in each], np.int64),
        "levels": np.array([len(each) for each in sizes], np.int64),
        "payloads": np.frombuffer(b"".join(p for tile in tiles for p in tile.payloads), np.uint8),
    }
    return arrays


def _record(arrays: dict[str, Any]) -> FrameRecord:
    blob, tiles = arrays["payloads"].tobytes(), []
    ends = np.cumsum(arrays["sizes"]).tolist()
    payloads = [blob[end - size : end] for size, end in zip(arrays["sizes"].tolist(), ends, strict=True)]
    for row, levels in enumerate(arrays["levels"].tolist()):
        low, high = arrays["bounds"][row].tolist()
        first, (kind, *looks, span) = int(arrays["first_ids"][row]), arrays["kinds"][row].tolist()
        bounds = (low[0], low[1], low[2]), (high[0], high[1], high[2])
        own, payloads = tuple(payloads[:levels]), payloads[levels:]
        of = (looks[0], looks[1]) if kind == TileKind.MOTION else None
        first_id = None if first < 0 else first
        tiles.append(TilePayloads(int(arrays["splats"][row]), first_id, bounds, own, TileKind(kind), of, span))
    return FrameRecord(tuple(tiles), arrays["source"].tobytes())
