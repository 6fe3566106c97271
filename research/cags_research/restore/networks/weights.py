"""Weights files: plain ``.npz`` archives of float32 arrays and one JSON text, never pickles.

The array ``about`` holds UTF-8 JSON: the network's name and shape, and how the weights came about (command, data, seed,
scores), so that a file explains itself. Everything is bounded and checked before a network takes it.
"""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cags_common.errors import ConfigError, DecodeError
from cags_common.files import write_whole
from cags_common.geometry import F32
from cags_common.npz import read_npz

VERSION = 1
MAX_FILE_BYTES = 4 << 20

_ABOUT = "about"
_SHIPPED = "cags_research.restore.networks.shipped"


@dataclass(frozen=True, eq=False)
class Weights:
    """Named arrays of one network, and what is known about them."""

    network: str  # registry name: srresnet, ...
    arrays: Mapping[str, F32]
    about: Mapping[str, Any]  # JSON: shape, command, data, scores

    @property
    def count(self) -> int:
        """Number of single weights."""
        return sum(array.size for array in self.arrays.values())

    @property
    def gated(self) -> bool:
        """Whether their network has a gate, and is given the expected PSNR as a third input."""
        return any(name.startswith("gate.") for name in self.arrays)

    def to_bytes(self) -> bytes:
        """An ``.npz`` archive; equal weights give equal bytes."""
        about = json.dumps({"version": VERSION, "network": self.network, **self.about}, sort_keys=True)
        out = io.BytesIO()
        with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
            _put(archive, _ABOUT, np.frombuffer(about.encode(), np.uint8))
            for name in sorted(self.arrays):
                _put(archive, name, np.ascontiguousarray(self.arrays[name], np.float32))
        return out.getvalue()

    def save(self, path: Path) -> None:
        """Write :meth:`to_bytes` to ``path``, atomically."""
        write_whole(path, self.to_bytes())

    @staticmethod
    def from_bytes(data: bytes, source: str) -> Weights:
        """Read an archive; ``source`` names it in errors. Raises :class:`ConfigError` for anything but weights."""
        if len(data) > MAX_FILE_BYTES:
            raise ConfigError(f"{source}: {len(data)} bytes are more than a weights file may have ({MAX_FILE_BYTES})")
        try:
            arrays = read_npz(data, MAX_FILE_BYTES)
            about = json.loads(arrays.pop(_ABOUT).tobytes())
        except (DecodeError, ValueError, KeyError, RecursionError) as error:
            raise ConfigError(f"{source}: is no weights file ({error}); train or fetch it again") from error
        return _checked(about, arrays, source)

    @staticmethod
    def load(path: Path) -> Weights:
        """Read a file. Raises :class:`ConfigError`."""
        try:
            with path.open("rb") as file:
                data = file.read(MAX_FILE_BYTES + 1)
        except OSError as error:
            raise ConfigError(f"{path}: cannot be read ({error.strerror}); give an existing weights file") from error
        return Weights.from_bytes(data, str(path))

    @staticmethod
    def shipped(network: str) -> Weights:
        """The weights that come with the program. Raises :class:`ConfigError` where there are none."""
        file = resources.files(_SHIPPED).joinpath(f"{network}.npz")
        if not file.is_file():
            raise ConfigError(f"no weights of {network!r} come with the program; train them with 'cags-train restore'")
        return Weights.from_bytes(file.read_bytes(), f"{network}.npz")


def _put(archive: zipfile.ZipFile, name: str, array: NDArray[Any]) -> None:
    entry = zipfile.ZipInfo(f"{name}.npy", date_time=(1980, 1, 1, 0, 0, 0))  # the same bytes on every day
    entry.compress_type = zipfile.ZIP_DEFLATED
    out = io.BytesIO()
    np.lib.format.write_array(out, array, allow_pickle=False)
    archive.writestr(entry, out.getvalue())


def _checked(about: Any, arrays: dict[str, NDArray[Any]], source: str) -> Weights:
    if not isinstance(about, dict) or not isinstance(about.get("network"), str):
        raise ConfigError(f"{source}: does not say which network it is for")
    if about.get("version") != VERSION:
        raise ConfigError(f"{source}: version {about.get('version')!r} is unknown; this program reads {VERSION}")
    for name, array in arrays.items():
        if array.dtype != np.float32 or not np.isfinite(array).all():
            raise ConfigError(f"{source}: {name} is not an array of finite float32 numbers")
    rest = {key: value for key, value in about.items() if key not in ("version", "network")}
    return Weights(about["network"], arrays, rest)
