"""PlayCanvas' compressed PLY: chunks of 256 splats, each splat packed into four words relative to its chunk's bounds.

The words: position 11-10-11 bits, rotation 2-10-10-10 (index of the largest component, then the others), logarithmic
scale 11-10-11, colour and opacity 8-8-8-8. Chunks may lack colour bounds (then 0..1). An element ``sh`` of bytes holds
the view-dependent coefficients.
Described by https://developer.playcanvas.com/user-manual/gaussian-splatting/formats/ply/
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from cags_common.errors import SceneError
from cags_common.geometry import F32, F64
from cags_common.splats import SH_C0, Splats
from cags_common.tiles.morton import morton_order
from cags_encoder.formats.files import (
    bytes_of_logits,
    check_count,
    directed,
    logit_of_bytes,
    quietly,
    smallest_three,
    split_largest,
)
from cags_encoder.formats.ply import sh_rest_names
from cags_encoder.formats.ply_container import (
    PlyHeader,
    check_properties,
    columns,
    header_bytes,
    parse_header,
    read_rows,
)
from cags_encoder.formats.repair import Check

CHUNK = 256
"""Number of splats that share one row of bounds."""

PACKED = ["packed_position", "packed_rotation", "packed_scale", "packed_color"]
SH_RANGE = 8.0
"""SH bytes span -4..4."""


def is_compressed_ply(header: PlyHeader) -> bool:
    """Whether a PLY file has this format."""
    vertex = header.element("vertex")
    return vertex is not None and any(name == "packed_position" for name, _ in vertex.properties)


@quietly
def parse_compressed_ply(data: bytes, source: str, check: Check = Splats.checked) -> Splats:
    """Splats from the bytes of a compressed PLY file; ``source`` names it in errors. Raises :class:`SceneError`."""
    header = parse_header(data, source)
    _check_header(header, source)
    rows = read_rows(data, header, source)
    vertex, chunk = rows["vertex"], rows["chunk"]
    position, rotation, scale, colour = (vertex[name].astype(np.uint32) for name in PACKED)
    bounds = _Bounds(chunk, np.arange(len(vertex)) // CHUNK)
    rgba = _fields(colour, (8, 8, 8, 8))
    splats = Splats(
        means=bounds.lerp(_unit(_fields(position, (11, 10, 11)), (11, 10, 11)), "xyz", ""),
        quats=_quats(rotation),
        log_scales=bounds.lerp(_unit(_fields(scale, (11, 10, 11)), (11, 10, 11)), "xyz", "scale_"),
        logit_opacities=logit_of_bytes(rgba[:, 3].astype(np.uint8)),
        sh0=(bounds.lerp(_unit(rgba[:, :3], (8, 8, 8)), "rgb", "") - np.float32(0.5)) / np.float32(SH_C0),
        sh_rest=_sh_rest(rows.get("sh"), header, len(vertex), source),
    )
    return check(splats, source)


def _check_header(header: PlyHeader, source: str) -> None:
    vertex, chunk, sh = (header.element(name) for name in ("vertex", "chunk", "sh"))
    if vertex is None or chunk is None:
        raise SceneError(f"{source}: lacks PLY element 'vertex' or 'chunk'; this is not a compressed PLY of splats")
    count = check_count(vertex.count, source)
    check_properties(vertex, PACKED, source)
    for prefix in ("", "scale_"):
        check_properties(chunk, _bounds_names(prefix, "xyz"), source)
    if any(name.endswith(("_r", "_g", "_b")) for name, _ in chunk.properties):
        check_properties(chunk, _bounds_names("", "rgb"), source)
    if chunk.count < -(-count // CHUNK):
        raise SceneError(f"{source}: has {chunk.count} chunks for {count} splats; {-(-count // CHUNK)} are needed")
    if sh is not None and sh.count != count:
        raise SceneError(f"{source}: has SH coefficients for {sh.count} of {count} splats; repair the file")


def _bounds_names(prefix: str, axes: str) -> list[str]:
    return [f"{end}_{prefix}{axis}" for end in ("min", "max") for axis in axes]


class _Bounds:
    """Bounds of chunks, looked up per splat."""

    def __init__(self, chunk: NDArray[np.void], of_splat: NDArray[np.intp]) -> None:
        self._chunk, self._of_splat = chunk, of_splat

    def lerp(self, unit: F32, axes: str, prefix: str) -> F32:
        """Scale ``unit`` [N, 3] from 0..1 to ``min_<prefix><axis>`` .. ``max_<prefix><axis>``."""
        names = self._chunk.dtype.names or ()
        if f"min_{prefix}{axes[0]}" not in names:  # early versions have no colour bounds
            return unit
        low, high = (columns(self._chunk, [f"{end}_{prefix}{axis}" for axis in axes]) for end in ("min", "max"))
        span = (high - low)[self._of_splat]
        return low[self._of_splat] + unit * span


def _fields(words: NDArray[np.uint32], bits: tuple[int, ...]) -> NDArray[np.uint32]:
    """Fields [N, len(bits)] of 32-bit words, most significant first."""
    shifts = [sum(bits[i + 1 :]) for i in range(len(bits))]
    return np.stack(
        [(words >> np.uint32(s)) & np.uint32((1 << b) - 1) for s, b in zip(shifts, bits, strict=True)], axis=1
    )


def _unit(values: NDArray[np.uint32], bits: tuple[int, ...]) -> F32:
    return (values / np.array([(1 << b) - 1 for b in bits], np.float64)).astype(np.float32)


def _quats(words: NDArray[np.uint32]) -> F32:
    fields = _fields(words, (2, 10, 10, 10))
    others = (_unit(fields[:, 1:], (10, 10, 10)) - np.float32(0.5)) * np.float32(np.sqrt(2.0))
    return directed(smallest_three(fields[:, 0].astype(np.intp), others))


def _sh_rest(rows: NDArray[np.void] | None, header: PlyHeader, count: int, source: str) -> NDArray[Any]:
    element = header.element("sh")
    if rows is None or element is None:
        return np.zeros((count, 0, 3), np.float32)
    names = sh_rest_names(element, source)
    values = columns(rows, names)
    unit = np.where(values == 0, 0.0, np.where(values == 255, 1.0, (values + 0.5) / 256.0)).astype(np.float32)
    return ((unit - 0.5) * SH_RANGE).astype(np.float32).reshape(count, 3, -1).transpose(0, 2, 1)


def compressed_ply_bytes(splats: Splats) -> bytes:
    """A compressed PLY file of ``splats`` in Morton order. Neighbours then share chunks, which keeps bounds tight.

    Errors of positions, scales and colours are at most half a step of their chunk's range (2047, 1023 or 255 steps),
    those of rotations half a step of 1.42/1023 in three components.
    """
    ordered = splats.take(morton_order(splats.means))
    count = len(ordered)
    colours = (ordered.sh0 * np.float32(SH_C0) + np.float32(0.5)).astype(np.float32)
    bounds, words = [], []
    for values, bits in ((ordered.means, (11, 10, 11)), (ordered.log_scales, (11, 10, 11)), (colours, (8, 8, 8))):
        low, high, unit = _chunk_units(values)
        bounds.append(np.concatenate([low, high], axis=1))
        words.append(_pack_unit(unit, bits))
    alpha = bytes_of_logits(ordered.logit_opacities).astype(np.uint32)
    quats = _pack_quats(ordered.quats)
    vertex = np.stack([words[0], quats, words[1], (words[2] << np.uint32(8)) | alpha], axis=1)
    axes = (("", "xyz"), ("scale_", "xyz"), ("", "rgb"))
    names = [name for prefix, letters in axes for name in _bounds_names(prefix, letters)]
    header = [f"element chunk {-(-count // CHUNK)}", *(f"property float {name}" for name in names)]
    header += [f"element vertex {count}", *(f"property uint {name}" for name in PACKED)]
    body = np.concatenate(bounds, axis=1).astype("<f4").tobytes() + vertex.astype("<u4").tobytes()
    if ordered.sh_degree:
        rest = ordered.sh_rest.transpose(0, 2, 1).reshape(count, -1)
        header += [f"element sh {count}", *(f"property uchar f_rest_{i}" for i in range(rest.shape[1]))]
        body += np.clip(np.floor((rest / SH_RANGE + 0.5) * 256.0), 0, 255).astype(np.uint8).tobytes()
    return header_bytes(header) + body


def _chunk_units(values: F32) -> tuple[F32, F32, F64]:
    """Bounds [C, 3] of each chunk of ``values`` [N, 3], and the values [N, 3] as fractions of their chunk's range."""
    starts = np.arange(0, len(values), CHUNK)
    low, high = np.minimum.reduceat(values, starts), np.maximum.reduceat(values, starts)
    of_splat = np.arange(len(values)) // CHUNK
    span = (high.astype(np.float64) - low)[of_splat]
    unit = np.divide(values.astype(np.float64) - low[of_splat], span, out=np.zeros_like(span), where=span > 0)
    return low, high, unit


def _pack_unit(unit: F64, bits: tuple[int, ...]) -> NDArray[np.uint32]:
    steps = np.array([(1 << b) - 1 for b in bits], np.float64)
    fields = np.round(np.clip(unit, 0.0, 1.0) * steps).astype(np.uint32)
    shifts = np.array([sum(bits[i + 1 :]) for i in range(len(bits))], np.uint32)
    words: NDArray[np.uint32] = np.bitwise_or.reduce(fields << shifts, axis=1)
    return words


def _pack_quats(quats: F32) -> NDArray[np.uint32]:
    largest, others = split_largest(quats)
    unit = others / np.sqrt(2.0) + 0.5
    return (largest.astype(np.uint32) << np.uint32(30)) | _pack_unit(unit, (10, 10, 10))
