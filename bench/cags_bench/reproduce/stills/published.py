"""Rows of other people's tables: copied, not measured here. Each names its table.

The paper compares with pictures of cameras, from its own clips; rows measured here compare with the unquantised splats.
The two can be read beside each other for sizes and times, and not for quality.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

DATASETS = ("Neural 3D Video", "Meeting Room", "Dynamic 3DGS")

SCALABLE_TABLE = "CAGS paper, supplement, 'scalable compression methods'"
RECENT_TABLE = "CAGS paper, supplement, 'recent compression methods'"


@dataclass(frozen=True)
class PublishedRow:
    """A method on a data set."""

    method: str
    dataset: str
    scalable: bool
    psnr_db: float
    ssim: float
    lpips: float
    size_mb: float
    decoding_s: float
    source: str


def published() -> Iterator[PublishedRow]:
    """All rows, method by method."""
    for source, scalable, table in ((SCALABLE_TABLE, True, _SCALABLE), (RECENT_TABLE, None, _RECENT)):
        for method, *columns in table:
            for dataset, figures in zip(DATASETS, columns, strict=True):
                levels = scalable if scalable is not None else method.startswith("SVQ")
                yield PublishedRow(method, dataset, levels, *figures, source)


_Figures = tuple[float, float, float, float, float]
_Row = tuple[str, _Figures, _Figures, _Figures]

_SCALABLE: tuple[_Row, ...] = (
    (
        "SPZ low",
        (23.3, 0.842, 0.112, 3.33, 0.076),
        (21.8, 0.822, 0.070, 2.54, 0.062),
        (21.1, 0.761, 0.130, 2.26, 0.052),
    ),
    (
        "SPZ high",
        (23.1, 0.842, 0.110, 4.53, 0.075),
        (21.8, 0.822, 0.068, 3.41, 0.057),
        (21.0, 0.760, 0.112, 3.32, 0.057),
    ),
    (
        "CompGS",
        (24.9, 0.898, 0.193, 22.20, 6.213),
        (25.0, 0.880, 0.221, 5.58, 0.799),
        (19.1, 0.721, 0.353, 4.27, 2.772),
    ),
    ("HAC", (22.2, 0.889, 0.203, 25.69, 24.407), (25.2, 0.873, 0.216, 8.69, 9.135), (20.5, 0.758, 0.338, 2.84, 1.571)),
    (
        "HAC++",
        (21.5, 0.885, 0.202, 17.98, 51.708),
        (25.2, 0.868, 0.222, 6.78, 14.706),
        (20.9, 0.780, 0.291, 2.00, 6.169),
    ),
    (
        "SVQ 66 bit",
        (24.5, 0.901, 0.108, 2.00, 0.015),
        (26.0, 0.887, 0.093, 1.53, 0.018),
        (25.3, 0.883, 0.153, 2.25, 0.028),
    ),
    (
        "SVQ 76 bit",
        (25.1, 0.907, 0.100, 2.14, 0.015),
        (26.4, 0.894, 0.079, 1.69, 0.019),
        (23.3, 0.874, 0.200, 2.42, 0.029),
    ),
)

_RECENT: tuple[_Row, ...] = (
    (
        "GIFStream",
        (23.6, 0.860, 0.130, 0.58, 0.050),
        (24.3, 0.879, 0.093, 0.48, 0.042),
        (13.6, 0.615, 0.375, 0.13, 0.015),
    ),
    ("QUEEN", (29.5, 0.933, 0.181, 17.36, 0.997), (31.4, 0.954, 0.153, 7.70, 0.437), (18.3, 0.788, 0.315, 3.41, 0.197)),
    (
        "SVQ (of this table)",
        (23.2, 0.829, 0.108, 0.75, 0.015),
        (21.8, 0.812, 0.093, 0.96, 0.018),
        (21.6, 0.766, 0.153, 1.08, 0.028),
    ),
)
"""That table's SVQ has other figures than the one of scalable codecs, and the paper does not say of which level."""
