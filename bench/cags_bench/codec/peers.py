"""Other formats for the same splats, each with one size and one quality."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import DracoPy
import numpy as np

from cags_bench.codec.readers import SplatTransform, gsply_read_ms
from cags_common.coding.packing import gunzip_bounded, gzip_bytes
from cags_common.splats import Splats
from cags_common.tiles.attributes import split_attributes
from cags_encoder.formats.sog import parse_sog_bytes
from cags_encoder.formats.spz import parse_spz, spz_bytes

DRACO_POSITION_BITS = 14
DRACO_VALUE_BITS = 8


@dataclass(frozen=True)
class Peer:
    """A format: encoder, decoder and readers."""

    name: str
    encode: Callable[[Splats], bytes]
    decode: Callable[[bytes], Splats]
    readers: Mapping[str, Callable[[bytes, int], float | None]] = field(default_factory=dict)
    """The format's own readers: (file, timed runs) -> median milliseconds, None if the reader is not installed."""


def peers(truth: Splats, tool: SplatTransform | None) -> list[Peer]:
    """The other formats. ``truth`` gives the ranges and shapes that a real file would hold in its header.

    SOG is written by its own program, ``tool``, because its k-means determines the quality of the files.
    """
    draco = _DracoAlone(truth)
    found = [
        _spz(tool),
        Peer("draco", draco.encode, draco.decode),
        Peer("gzip-float32", _gzip, lambda data: _gunzip(data, truth)),
    ]
    return found if tool is None else [*found, _sog(tool)]


def _spz(tool: SplatTransform | None) -> Peer:
    readers: dict[str, Callable[[bytes, int], float | None]] = {"gsply": gsply_read_ms}
    if tool is not None:
        readers["splat-transform"] = lambda data, repeats: tool.read_ms(data, ".spz", repeats)
    return Peer("spz", spz_bytes, lambda data: parse_spz(data, "spz"), readers)


def _sog(tool: SplatTransform) -> Peer:
    return Peer(
        "sog",
        lambda splats: tool.convert(splats, ".sog"),
        lambda data: parse_sog_bytes(data, "sog"),
        {"splat-transform": lambda data, repeats: tool.read_ms(data, ".sog", repeats)},
    )


class _DracoAlone:
    """Positions on a grid over the whole scene and every other value as a byte over its range, in one Draco cloud."""

    def __init__(self, truth: Splats) -> None:
        names = ["means", "quats", "log_scales", "logit_opacities", "sh0", "sh_rest"]
        self._names = [name for name in names[1:] if getattr(truth, name).size]
        columns = {name: getattr(truth, name).reshape(len(truth), -1) for name in self._names}
        columns["logit_opacities"] = split_attributes(truth)["alpha"]
        self._low = {name: values.min(axis=0) for name, values in columns.items()}
        self._step = {
            name: np.maximum(np.ptp(values, axis=0), 1e-9) / (2**DRACO_VALUE_BITS - 1)
            for name, values in columns.items()
        }
        self._shape = {name: getattr(truth, name).shape[1:] for name in self._names}

    def encode(self, splats: Splats) -> bytes:
        attributes = {}
        for index, name in enumerate(self._names):
            values = getattr(splats, name).reshape(len(splats), -1)
            if name == "logit_opacities":
                values = split_attributes(splats)["alpha"]
            attributes[index] = np.rint((values - self._low[name]) / self._step[name]).clip(0, 255).astype(np.uint8)
        data: bytes = DracoPy.encode(
            splats.means, quantization_bits=DRACO_POSITION_BITS, preserve_order=True, generic_attributes=attributes
        )
        return data

    def decode(self, data: bytes) -> Splats:
        cloud = DracoPy.decode(data)
        columns = {a["unique_id"]: a["data"] for a in cloud.attributes if a["attribute_type"] != 0}
        values = {}
        for index, name in enumerate(self._names):
            flat = columns[index].astype(np.float32) * self._step[name] + self._low[name]
            if name == "logit_opacities":
                alpha = flat.clip(1e-4, 1 - 1e-4)
                flat = np.log(alpha / (1 - alpha))
            values[name] = flat.reshape(len(flat), *self._shape[name]).astype(np.float32)
        values.setdefault("sh_rest", np.zeros((len(cloud.points), 0, 3), np.float32))
        return Splats(means=np.ascontiguousarray(cloud.points, np.float32), **values).checked("draco")


def _gzip(splats: Splats) -> bytes:
    return gzip_bytes(b"".join(np.ascontiguousarray(array).tobytes() for _, array in splats.arrays()))


def _gunzip(data: bytes, truth: Splats) -> Splats:
    raw = gunzip_bounded(data, sum(array.nbytes for _, array in truth.arrays()), "gzip")
    arrays, at = {}, 0
    for name, array in truth.arrays():
        arrays[name] = np.frombuffer(raw, np.float32, array.size, at).reshape(array.shape).copy()
        at += array.nbytes
    return replace(truth, **arrays)
