"""Writes SOG version 2: codebooks, then images and ``meta.json`` in a zip."""

from __future__ import annotations

import io
import json
import zipfile
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cags_common.geometry import F32, F64
from cags_common.splats import Splats
from cags_common.tiles.morton import morton_order
from cags_encoder.formats.files import bytes_of_logits, directed, logit_of_bytes, smallest_three, split_largest
from cags_encoder.formats.sog import CODEBOOK, MAX_PALETTE, PALETTE_ROW, QUAT_TAG

_EPOCH = (1980, 1, 1, 0, 0, 0)
"""Time stamp of all entries, fixed so that the same splats give the same bytes."""


def sog_bytes(splats: Splats) -> bytes:
    """A bundled SOG file of ``splats`` in Morton order.

    While the palette of 65,536 entries holds all combinations of harmonics, only the codebook limits view-dependent
    colour. Beyond that, an evenly chosen subset is kept and each splat takes the nearest entry.
    """
    ordered = splats.take(morton_order(splats.means))
    logs = np.sign(ordered.means) * np.log1p(np.abs(ordered.means.astype(np.float64)))
    low, high = logs.min(axis=0), logs.max(axis=0)
    words = np.round((logs - low) / np.where(high > low, high - low, 1.0) * 65535.0).astype(np.uint16)
    scale_book, scales = _codebook(ordered.log_scales)
    colour_book, colours = _codebook(ordered.sh0)
    alpha = bytes_of_logits(ordered.logit_opacities)[:, None]
    images: dict[str, NDArray[np.uint8]] = {
        "means_l.webp": _image((words & 255).astype(np.uint8)),
        "means_u.webp": _image((words >> 8).astype(np.uint8)),
        "scales.webp": _image(scales),
        "quats.webp": _image(_quats(ordered.quats)),
        "sh0.webp": _image(np.concatenate([colours, alpha], axis=1)),
    }
    meta: dict[str, Any] = {
        "version": 2,
        "count": len(ordered),
        "means": {"mins": low.tolist(), "maxs": high.tolist(), "files": ["means_l.webp", "means_u.webp"]},
        "scales": {"codebook": scale_book.tolist(), "files": ["scales.webp"]},
        "quats": {"files": ["quats.webp"]},
        "sh0": {"codebook": colour_book.tolist(), "files": ["sh0.webp"]},
    }
    if ordered.sh_degree:
        meta["shN"] = _sh(ordered, images)
    return _zip(meta, images)


def quantised_as_sog(splats: Splats) -> Splats:
    """``splats`` in their order after a round trip through a SOG file whose palette holds all of their harmonics."""
    logs, low, step = _logarithms(splats.means)
    words = low + np.round((logs - low) / step) * step
    largest, others = split_largest(splats.quats)
    bytes_ = np.clip(np.round((others * np.sqrt(2.0) + 1.0) * 127.5), 0, 255)
    values = {"log_scales": splats.log_scales, "sh0": splats.sh0, "sh_rest": splats.sh_rest}
    for name, array in values.items():
        if array.size:
            book, codes = _codebook(array)
            values[name] = book[codes]
    return Splats(
        means=(np.sign(words) * np.expm1(np.abs(words))).astype(np.float32),
        quats=directed(smallest_three(largest, (bytes_ / 127.5 - 1.0) * np.sqrt(0.5))),
        logit_opacities=logit_of_bytes(bytes_of_logits(splats.logit_opacities)),
        **values,
    )


def _logarithms(means: F32) -> tuple[F64, F64, F64]:
    """Positions as SOG stores them (logarithmic on both sides of zero), their minimum, and the step of 16 bits."""
    logs = np.sign(means) * np.log1p(np.abs(means.astype(np.float64)))
    low, high = logs.min(axis=0), logs.max(axis=0)
    return logs, low, np.where(high > low, high - low, 1.0) / 65535.0


def _codebook(values: F32) -> tuple[F32, NDArray[np.uint8]]:
    """256 ascending values, and for each of ``values`` the index of the nearest.

    Half of them are quantiles, which follow the density; half are equal steps, which cover rare large values.
    """
    wide = np.sort(values.astype(np.float64).ravel())
    quantiles = np.quantile(wide, (np.arange(CODEBOOK // 2) + 0.5) / (CODEBOOK // 2))
    steps = np.linspace(wide[0], wide[-1], CODEBOOK // 2)
    book = np.sort(np.concatenate([quantiles, steps])).astype(np.float32)
    return book, _nearest(book, values)


def _nearest(book: F32, values: F32) -> NDArray[np.uint8]:
    middles = (book[1:].astype(np.float64) + book[:-1]) / 2
    return np.searchsorted(middles, values.astype(np.float64)).astype(np.uint8)


def _quats(quats: F32) -> NDArray[np.uint8]:
    largest, others = split_largest(quats)
    bytes_ = np.round((others * np.sqrt(2.0) + 1.0) * 127.5)
    return np.concatenate([np.clip(bytes_, 0, 255), QUAT_TAG + largest[:, None]], axis=1).astype(np.uint8)


def _sh(splats: Splats, images: dict[str, NDArray[np.uint8]]) -> dict[str, Any]:
    """Add the palette's images to ``images`` and return its part of the meta data."""
    from scipy.spatial import cKDTree

    book, codes = _codebook(splats.sh_rest.reshape(len(splats), -1))
    palette, labels = np.unique(codes, axis=0, return_inverse=True)
    labels = labels.ravel()
    if len(palette) > MAX_PALETTE:
        kept = palette[np.linspace(0, len(palette) - 1, MAX_PALETTE).astype(np.int64)]
        labels = cKDTree(book[kept]).query(book[codes])[1]
        palette = kept
    coefficients = splats.sh_rest.shape[1]
    rows = -(-len(palette) // PALETTE_ROW)
    centroids = np.zeros((rows * PALETTE_ROW, coefficients, 3), np.uint8)
    centroids[: len(palette)] = palette.reshape(-1, coefficients, 3)
    images["shN_centroids.webp"] = centroids.reshape(rows, PALETTE_ROW * coefficients, 3)
    pairs = np.stack([labels & 255, labels >> 8, np.zeros_like(labels)], axis=1).astype(np.uint8)
    images["shN_labels.webp"] = _image(pairs)
    files = ["shN_centroids.webp", "shN_labels.webp"]
    return {"count": len(palette), "bands": splats.sh_degree, "codebook": book.tolist(), "files": files}


def _image(channels: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """[N, C] as a nearly square image [H, W, C], padded with opaque black."""
    count, depth = channels.shape
    width = 4 * -(-int(np.ceil(np.sqrt(count))) // 4)
    height = -(-count // width)
    image = np.zeros((height * width, depth), np.uint8)
    image[:count] = channels
    image[count:, 3:] = 255
    return image.reshape(height, width, depth)


def _zip(meta: dict[str, Any], images: dict[str, NDArray[np.uint8]]) -> bytes:
    from PIL import Image  # slow import that only this format needs

    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        for name, pixels in images.items():
            encoded = io.BytesIO()
            Image.fromarray(pixels).save(encoded, "WEBP", lossless=True, exact=True, quality=90, method=4)
            archive.writestr(zipfile.ZipInfo(name, _EPOCH), encoded.getvalue())
        archive.writestr(zipfile.ZipInfo("meta.json", _EPOCH), json.dumps(meta))
    return out.getvalue()
