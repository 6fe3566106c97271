"""Where bundles live: a local folder or any fsspec URL (``s3://``, ``http://``, ``memory://``)."""

from __future__ import annotations

import os
import shutil
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol

from cags_common.errors import BundleError

ANSWER_S, SLOWEST_BYTES_S = 5.0, 1e6
"""How long a remote store may take for a read: so many seconds, and more for what is large."""

AGAIN_S = 1.0
"""From one attempt to the next to reach a store that has stopped answering."""


LOCAL_SCHEMES = ("file://", "local://", "file:", "local:")
"""What fsspec takes as the beginning of a local path."""


class ByteStore(Protocol):
    """Reads named files of one bundle."""

    def read(self, name: str, start: int, end: int) -> bytes:
        """Bytes ``start`` to ``end`` of a file. Raises :class:`BundleError`, also when the file is too short."""
        ...

    def read_all(self, name: str, limit_bytes: int) -> bytes:
        """A whole file of at most ``limit_bytes``. Raises :class:`BundleError`."""
        ...

    def has(self, name: str) -> bool:
        """Whether there is such a file. Raises :class:`BundleError`."""
        ...


def filesystem(url: str) -> tuple[Any, str]:
    """The fsspec filesystem of ``url`` and the path in it. Raises :class:`BundleError` for an unknown scheme."""
    import fsspec

    try:
        fs, path = fsspec.core.url_to_fs(url)
    except ImportError as error:
        way_out = "pip install 'cags-stream[scale]' for s3://, or what it says"
        raise BundleError(f"{url}: cannot be opened ({error}); {way_out}") from error
    except Exception as error:  # stores of other makers raise what they like, and some connect at once
        raise BundleError(
            f"{url}: cannot be opened ({error}); give a folder or an address such as s3://BUCKET/NAME"
        ) from error
    return fs, str(path).rstrip("/")


def local_path(url: str) -> Path | None:
    """The folder that ``url`` names on this machine, or None for another store."""
    for scheme in LOCAL_SCHEMES:
        if url.startswith(scheme):
            return Path(url.removeprefix(scheme))
    return None if "://" in url else Path(url)


def written_folder(url: str) -> Path | None:
    """The folder that a bundle written to ``url`` takes, absolute; None for another store.

    A symbolic link stays a link: what it points to is written.
    """
    path = local_path(url)
    return None if path is None else Path(os.path.realpath(path))  # Path.resolve raises for links in a circle


class UrlStore:
    """A bundle's files under an fsspec URL. Safe to use from several threads.

    A remote store that stops answering holds nobody up for long: the read that meets it fails after ``ANSWER_S``,
    later ones fail at once, while a thread asks on until the store answers. Local file systems, and caches over others,
    have no such limit.
    """

    def __init__(self, url: str) -> None:
        from fsspec.asyn import AsyncFileSystem  # here, as in filesystem(): it takes a while

        self._url = url
        self._fs, self._path = filesystem(url)
        self._limited = isinstance(self._fs, AsyncFileSystem)
        self._silent = threading.Event()
        self._lock = threading.Lock()

    def read(self, name: str, start: int, end: int) -> bytes:
        """Bytes ``start`` to ``end`` of a file."""
        if start == end:
            return b""
        data = self._cat(name, start, end)
        if len(data) != end - start:
            raise BundleError(f"{self._url}/{name}: ends at byte {start + len(data)}, before {end}; it was cut short")
        return data

    def read_all(self, name: str, limit_bytes: int) -> bytes:
        """A whole file of at most ``limit_bytes``."""
        data = self._cat(name, 0, limit_bytes + 1)
        if len(data) > limit_bytes:
            raise BundleError(f"{self._url}/{name}: is larger than {limit_bytes} bytes")
        return data

    def has(self, name: str) -> bool:
        """Whether there is such a file."""
        with self._reading(name):
            return bool(self._fs.exists(f"{self._path}/{name}", **self._limit(0)))

    def _cat(self, name: str, start: int, end: int) -> bytes:
        with self._reading(name):
            return self._asked(name, start, end)

    def _asked(self, name: str, start: int, end: int) -> bytes:
        limit = self._limit(end - start)
        return bytes(self._fs.cat_file(f"{self._path}/{name}", start=start, end=end, **limit))

    def _limit(self, size_bytes: int) -> dict[str, float]:
        """How long a read may take, for file systems that can be told."""
        return {"timeout": ANSWER_S + size_bytes / SLOWEST_BYTES_S} if self._limited else {}

    def _why_absent(self, name: str) -> str:
        folder = local_path(self._url)
        if folder is not None and not folder.exists():
            return "no such folder; cags-encode makes bundles"
        if folder is not None and folder.is_file():
            return "is a file, and a bundle is a folder; cags-encode makes one"
        return f"has no {name}; is it a bundle made by cags-encode?"

    @contextmanager
    def _reading(self, name: str) -> Iterator[None]:
        """Whatever goes wrong in it is a bundle's error: stores of other makers raise what they like."""
        if self._silent.is_set():
            raise self._no_answer(name)
        try:
            yield
        except (FileNotFoundError, NotADirectoryError) as error:
            raise BundleError(f"{self._url}: {self._why_absent(name)}") from error
        except TimeoutError as error:
            self._ask_on(name)
            raise self._no_answer(name) from error
        except OSError as error:
            way_out = "check the address and who may read it"
            raise BundleError(f"{self._url}/{name}: cannot be read ({error.strerror or error}); {way_out}") from error
        except Exception as error:
            way_out = "check the address and, for s3, the credentials in the environment"
            raise BundleError(f"{self._url}/{name}: cannot be read ({error}); {way_out}") from error

    def _no_answer(self, name: str) -> BundleError:
        return BundleError(f"{self._url}/{name}: the store does not answer; it is asked again until it does")

    def _ask_on(self, name: str) -> None:
        """Fail reads at once until the store answers again; it is asked for a byte of ``name``."""
        if not self._limited:
            return
        with self._lock:
            if self._silent.is_set():
                return
            self._silent.set()
        threading.Thread(target=self._wait_for_answer, args=(name,), name="cags-store", daemon=True).start()

    def _wait_for_answer(self, name: str) -> None:
        while True:
            time.sleep(AGAIN_S)
            try:
                self._asked(name, 0, 1)
            except TimeoutError:
                continue
            except Exception:  # an answer, if not the one that was hoped for: whoever reads next is told what it is
                break
            break
        self._silent.clear()


def replace_files(url: str, files: Mapping[str, bytes]) -> None:
    """Write files into a bundle that is there, in order, each by renaming: readers find the old or the new, whole.

    Raises :class:`BundleError`.
    """
    fs, path = filesystem(url)
    try:
        for name, content in files.items():
            with fs.open(f"{path}/.{name}.new", "wb") as file:
                file.write(content)
            fs.mv(f"{path}/.{name}.new", f"{path}/{name}")
    except OSError as error:
        raise BundleError(f"{url}: cannot be written ({error.strerror or error})") from error


def remove_tree(path: Path) -> None:
    """Delete a local folder if it is there."""
    if path.is_dir():
        shutil.rmtree(path)
