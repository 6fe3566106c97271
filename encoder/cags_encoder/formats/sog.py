"""PlayCanvas' SOG ("spatially ordered Gaussians"), versions 1 and 2: lossless images beside a ``meta.json``.

A data set is a folder of these files or a zip of them (``.sog``). The specified frame is right, up, back, but
converters keep the capture's frame, which usually has y down. Described by
https://developer.playcanvas.com/user-manual/gaussian-splatting/formats/sog/.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cags_common.errors import SceneError
from cags_common.geometry import F32
from cags_common.splats import SH_REST_OF_DEGREE, Splats
from cags_encoder.formats.files import check_count, directed, logit_of_bytes, quietly, smallest_three
from cags_encoder.formats.repair import Check
from cags_encoder.formats.sog_files import SogFiles
from cags_encoder.formats.sog_meta import SogMeta

CODEBOOK = 256
PALETTE_ROW = 64
"""Centroids in one row of the palette image."""

MAX_PALETTE = 65_536
"""SH palettes use 16-bit indices."""

QUAT_TAG = 252
"""Alpha 252..255 gives the largest component of a rotation; any other value means the identity."""


@quietly
def parse_sog(files: SogFiles, check: Check = Splats.checked) -> Splats:
    """The splats of a SOG data set. Raises :class:`SceneError`."""
    meta = SogMeta(files.json("meta.json"), files.source)
    if not meta.has("version"):
        return _parse_v1(files, meta, check)
    version = meta.integer("version", 0, 2**31)
    if version != 2:
        raise SceneError(f"{files.source}: is SOG version {version}; versions 1 and 2 are supported")
    count = check_count(meta.integer("count", -(2**63), 2**63), files.source)
    sh0 = files.texels(meta.file("sh0", 0, 1), count)
    splats = Splats(
        means=sog_means(files, meta, count),
        quats=sog_quats(files, meta, count),
        log_scales=meta.numbers("scales.codebook", CODEBOOK)[files.texels(meta.file("scales", 0, 1), count)[:, :3]],
        logit_opacities=logit_of_bytes(sh0[:, 3]),
        sh0=meta.numbers("sh0.codebook", CODEBOOK)[sh0[:, :3]],
        sh_rest=_sh_rest(files, meta, count),
    )
    return check(splats, files.source)


def parse_sog_bytes(data: bytes, source: str, check: Check = Splats.checked) -> Splats:
    """Splats from the bytes of a bundled SOG file; ``source`` names it in errors. Raises :class:`SceneError`."""
    return parse_sog(SogFiles.from_bytes(data, source), check)


def _parse_v1(files: SogFiles, meta: SogMeta, check: Check) -> Splats:
    """Version 1 (``sogs``): the same images, but linear ranges instead of codebooks, and opacity as a logit."""
    shape = meta.numbers("means.shape", 2)
    count = check_count(int(min(shape[0], 1e9)) if np.isfinite(shape[0]) else 0, files.source)
    sh0 = _lerp(files.texels(meta.file("sh0", 0, 1), count), meta, "sh0", 4)
    splats = Splats(
        means=sog_means(files, meta, count),
        quats=sog_quats(files, meta, count),
        log_scales=_lerp(files.texels(meta.file("scales", 0, 1), count)[:, :3], meta, "scales", 3),
        logit_opacities=sh0[:, 3],
        sh0=sh0[:, :3],
        sh_rest=_sh_rest_v1(files, meta, count),
    )
    return check(splats, files.source)


def _lerp(bytes_: NDArray[np.uint8], meta: SogMeta, name: str, width: int) -> F32:
    low, high = meta.numbers(f"{name}.mins", width), meta.numbers(f"{name}.maxs", width)
    return low + bytes_ / np.float32(255.0) * (high - low)


def sog_means(files: SogFiles, meta: SogMeta, count: int) -> F32:
    """Positions [count, 3]: 16 bits per axis in two images, logarithmic on both sides of zero."""
    low, high = meta.numbers("means.mins", 3), meta.numbers("means.maxs", 3)
    lower, upper = (files.texels(meta.file("means", i, 2), count)[:, :3] for i in range(2))
    words = lower.astype(np.uint16) | (upper.astype(np.uint16) << 8)
    logarithm = low.astype(np.float64) + words / 65535.0 * (high.astype(np.float64) - low)
    return (np.sign(logarithm) * np.expm1(np.abs(logarithm))).astype(np.float32)


def sog_quats(files: SogFiles, meta: SogMeta, count: int) -> F32:
    """Rotations [count, 4] ``wxyz``: three components of one byte each; the largest is implied."""
    rgba = files.texels(meta.file("quats", 0, 1), count)
    others = (rgba[:, :3] / np.float32(255.0) * 2 - 1) * np.float32(np.sqrt(0.5))
    tag = rgba[:, 3].astype(np.intp) - QUAT_TAG
    quats = smallest_three(np.maximum(tag, 0), others)
    quats[tag < 0] = (1.0, 0.0, 0.0, 0.0)
    return directed(quats)


def _sh_rest(files: SogFiles, meta: SogMeta, count: int) -> F32:
    if not meta.has("shN"):
        return np.zeros((count, 0, 3), np.float32)
    coefficients = SH_REST_OF_DEGREE[meta.integer("shN.bands", 0, 3)]
    palette = meta.integer("shN.count", 1, MAX_PALETTE)
    codebook = meta.numbers("shN.codebook", CODEBOOK)
    if coefficients == 0:
        return np.zeros((count, 0, 3), np.float32)
    labels = files.texels(meta.file("shN", 1, 2), count).astype(np.int64)
    return _centroids(files, meta, coefficients, palette, codebook)[_label(labels, palette, files.source)]


def _sh_rest_v1(files: SogFiles, meta: SogMeta, count: int) -> F32:
    if not meta.has("shN"):
        return np.zeros((count, 0, 3), np.float32)
    width, height = files.size(meta.file("shN", 0, 2))
    coefficients = width // PALETTE_ROW
    if width % PALETTE_ROW or coefficients not in SH_REST_OF_DEGREE[1:]:
        raise SceneError(
            f"{files.source}: its SH palette is {width} px wide; 192, 512 or 960 are needed for degree 1, 2 or 3"
        )
    low, high = meta.number("shN.mins"), meta.number("shN.maxs")
    palette = min(height * PALETTE_ROW, MAX_PALETTE)
    codebook = (low + np.arange(CODEBOOK) / 255.0 * (high - low)).astype(np.float32)
    labels = files.texels(meta.file("shN", 1, 2), count).astype(np.int64)
    return _centroids(files, meta, coefficients, palette, codebook)[_label(labels, palette, files.source)]


def _centroids(files: SogFiles, meta: SogMeta, coefficients: int, palette: int, codebook: F32) -> F32:
    """The palette [palette, coefficients, 3]: 64 centroids per row, with their coefficients side by side."""
    rows = -(-palette // PALETTE_ROW)
    image = files.image(meta.file("shN", 0, 2), max_pixels=rows * PALETTE_ROW * coefficients)
    if image.shape[1] != PALETTE_ROW * coefficients or image.shape[0] < rows:
        raise SceneError(
            f"{files.source}: its SH palette is {image.shape[1]}x{image.shape[0]} px, "
            f"expected {PALETTE_ROW * coefficients}x{rows} for {palette} entries"
        )
    return codebook[image[:rows, :, :3].reshape(rows * PALETTE_ROW, coefficients, 3)]


def _label(rgba: NDArray[np.int64], palette: int, source: str) -> NDArray[np.int64]:
    labels = rgba[:, 0] | (rgba[:, 1] << 8)
    if labels.max() >= palette:
        row = int(np.argmax(labels >= palette))
        raise SceneError(f"{source}: SH label {labels[row]} of splat {row} is outside its palette of {palette}")
    return labels
