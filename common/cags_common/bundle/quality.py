"""What was measured while encoding: the tables behind the paper's two figures on LoD assignment (supplement).

Kept as ``quality.json`` beside the manifest, for people and plots; no player needs it.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from typing import Any

from cags_common.errors import BundleError

QUALITY_NAME = "quality.json"
MAX_QUALITY_BYTES = 1 << 20


@dataclass(frozen=True, slots=True)
class LayerQuality:
    """One attribute cut to ``layer`` enhancement layers while all others are whole."""

    attribute: str
    layer: int
    size_bytes: int
    """Bytes of that layer alone in the first frame; 0 for the base layer, whose bytes LoD 0 holds."""
    psnr_db: float
    ssim: float


@dataclass(frozen=True, slots=True)
class LevelQuality:
    """All tiles at one LoD."""

    lod: int
    size_bytes: int
    """Bytes of LoD 0 to this one in the first frame."""
    psnr_db: float
    ssim: float


@dataclass(frozen=True, slots=True)
class LodQuality:
    """Quality over covered pixels of a few views of the first frame, against the unquantised splats, unrestored."""

    layers: tuple[LayerQuality, ...]
    ladder: tuple[LevelQuality, ...]

    def to_json(self) -> bytes:
        """UTF-8 JSON; equal tables give equal bytes."""
        return json.dumps(asdict(self), separators=(",", ":"), sort_keys=True, allow_nan=False).encode()

    @staticmethod
    def from_json(data: bytes) -> LodQuality:
        """Parse and check. Raises :class:`BundleError`."""
        try:
            table = json.loads(data)
            return LodQuality(
                tuple(
                    LayerQuality(str(row["attribute"]), int(row["layer"]), *_numbers(row)) for row in table["layers"]
                ),
                tuple(LevelQuality(int(row["lod"]), *_numbers(row)) for row in table["ladder"]),
            )
        except (ValueError, KeyError, TypeError, OverflowError, RecursionError) as error:
            why = f"{type(error).__name__}: {error}"  # repr quotes the whole file where it is not UTF-8
            raise BundleError(f"{QUALITY_NAME}: is damaged ({why}); encode the bundle again") from error


def _numbers(row: dict[str, Any]) -> tuple[int, float, float]:
    return int(row["size_bytes"]), float(row["psnr_db"]), float(row["ssim"])
