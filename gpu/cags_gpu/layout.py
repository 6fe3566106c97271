"""The structs that host and shaders share, packed as WGSL lays them out; a test holds both together."""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from cags_common.geometry import Camera
from cags_common.raster.base import Exactness, RenderOptions
from cags_common.raster.definition import JACOBIAN_MARGIN

TILE_PX = 16
BRIGHTEST = 3e38
"""Where colours end that no display shows."""

FIXED_RANGE_PX = 65536.0
"""Focal lengths and coordinates up to it have exact centres."""

STOP = {Exactness.FAST: 1 / 255, Exactness.BALANCED: 1e-4, Exactness.EXACT: 1e-6}
"""A pixel is given up when it transmits no more."""


@dataclass(frozen=True)
class Layout:
    """A WGSL struct of 4-byte scalars: field -> (offset in bytes, ``f`` or ``I``, how many)."""

    fields: Mapping[str, tuple[int, str, int]]
    size: int

    def pack(self, **values: object) -> bytes:
        """The struct's bytes. Fields that are not named are zero; raises ``KeyError`` for a name that is not there."""
        numbers: list[object] = []
        for name, (_, _, count) in self.fields.items():
            given = values.pop(name, 0)
            listed = given.tolist() if isinstance(given, np.ndarray) else given
            some = listed if isinstance(listed, list | tuple) else (listed,)
            if len(some) > count:
                raise ValueError(f"{name} holds {count} numbers, not {len(some)}")
            numbers += [*some, *(0,) * (count - len(some))]
        if values:
            raise KeyError(next(iter(values)))
        return self._format.pack(*numbers)

    def put(self, packed: bytearray, start: int, name: str, number: float) -> None:
        """Change one number of the struct that begins at ``start``."""
        offset, kind, _ = self.fields[name]
        struct.pack_into(f"<{kind}", packed, start + offset, number)

    @cached_property
    def _format(self) -> struct.Struct:
        text, at = "<", 0
        for offset, kind, count in self.fields.values():
            text += f"{offset - at}x{count}{kind}"
            at = offset + 4 * count
        return struct.Struct(f"{text}{self.size - at}x")


VIEW = Layout(
    {
        "row_x": (0, "f", 4),
        "row_y": (16, "f", 4),
        "row_z": (32, "f", 4),
        "position": (48, "f", 4),
        "position_rest": (64, "f", 4),
        "focal": (80, "f", 2),
        "principal": (88, "f", 2),
        "limit": (96, "f", 2),
        "size": (104, "I", 2),
        "tiles": (112, "I", 2),
        "near": (120, "f", 1),
        "dilation": (124, "f", 1),
        "variance": (128, "f", 1),
        "void_alpha": (132, "f", 1),
        "stop": (136, "f", 1),
        "brightest": (140, "f", 1),
        "count": (144, "I", 1),
        "sh_count": (148, "I", 1),
        "sh_used": (152, "I", 1),
        "capacity": (156, "I", 1),
        "splats": (160, "I", 1),
        "base": (164, "I", 1),
        "layers": (168, "I", 1),
        "unused": (172, "I", 1),
        "row_x_x": (176, "I", 4),
        "row_x_y": (192, "I", 4),
        "row_x_z": (208, "I", 4),
        "row_y_x": (224, "I", 4),
        "row_y_y": (240, "I", 4),
        "row_y_z": (256, "I", 4),
        "row_z_x": (272, "I", 4),
        "row_z_y": (288, "I", 4),
        "row_z_z": (304, "I", 4),
        "from_x": (320, "I", 4),
        "from_y": (336, "I", 4),
        "from_z": (352, "I", 4),
        "focal_x": (368, "I", 4),
        "focal_y": (384, "I", 4),
        "principal_xy": (400, "I", 4),
    },
    416,
)
CHUNK = Layout({"first": (0, "I", 1), "count": (4, "I", 1), "unused_a": (8, "I", 1), "unused_b": (12, "I", 1)}, 16)
UPDATE = Layout({"rows": (0, "I", 1), "sh_words": (4, "I", 1), "width": (8, "I", 1), "unused": (12, "I", 1)}, 16)
SORT = Layout({"shift": (0, "I", 1), "count": (4, "I", 1), "blocks": (8, "I", 1), "counted": (12, "I", 1)}, 16)
COUNT = Layout({"count": (0, "I", 1), "base": (4, "I", 1), "unused_a": (8, "I", 1), "unused_b": (12, "I", 1)}, 16)
CORRECTION = Layout(
    {
        "m0": (0, "f", 4),
        "m1": (16, "f", 4),
        "m2": (32, "f", 4),
        "size": (48, "I", 2),
        "reference": (56, "I", 2),
        "cell": (64, "f", 2),
        "stride": (72, "I", 1),
        "tolerance": (76, "f", 1),
        "slope_cells": (80, "f", 1),
        "border": (84, "f", 1),
        "knee": (88, "f", 1),
        "hole_alpha": (92, "f", 1),
        "grid": (96, "I", 2),
        "unused": (104, "I", 1),
        "veto_cell": (108, "I", 1),
    },
    112,
)
COMPAND = Layout({"size": (0, "I", 2), "knee": (8, "f", 1), "unused": (12, "I", 1)}, 16)
COMPARE = Layout({"size": (0, "I", 2), "error": (8, "f", 1), "unused": (12, "I", 1)}, 16)
CHANGED = Layout(
    {
        "size": (0, "I", 2),
        "grid": (8, "I", 2),
        "count": (16, "I", 1),
        "behind": (20, "f", 1),
        "stale": (24, "f", 1),
        "unused": (28, "I", 1),
    },
    32,
)
ENLARGE = Layout({"size": (0, "I", 2), "half": (8, "I", 2)}, 16)

LAYOUTS = {
    "View": VIEW,
    "Chunk": CHUNK,
    "Update": UPDATE,
    "Sort": SORT,
    "Count": COUNT,
    "Correction": CORRECTION,
    "Compand": COMPAND,
    "Compare": COMPARE,
    "Changed": CHANGED,
    "Enlarge": ENLARGE,
}
"""By the names that the shaders give them."""


def tiles_of(camera: Camera) -> tuple[int, int]:
    """Tiles along x and y of a camera's picture."""
    return -(-camera.width_px // TILE_PX), -(-camera.height_px // TILE_PX)


@lru_cache(maxsize=64)
def view_bytes(
    camera: Camera, options: RenderOptions, *, splats: int, sh_count: int, sh_used: int, capacity: int, layers: int = 1
) -> bytes:
    """The ``View`` of a camera and options over a scene of ``splats`` with ``sh_count`` harmonics a channel: the first
    of ``layers`` that are drawn together.
    """
    i, rotation = camera.intrinsics, camera.world_to_camera[0]
    position = np.asarray(camera.pose.position, np.float64)
    leading = position.astype(np.float32)
    size = np.array([i.width_px, i.height_px])
    footprint = options.footprint
    return VIEW.pack(
        row_x=rotation[0],
        row_y=rotation[1],
        row_z=rotation[2],
        position=leading,
        position_rest=position - leading,
        focal=(i.fx_px, i.fy_px),
        principal=(i.cx_px, i.cy_px),
        limit=JACOBIAN_MARGIN * 0.5 * size / np.array([i.fx_px, i.fy_px]),
        size=size,
        tiles=tiles_of(camera),
        near=camera.near,
        dilation=footprint.dilation_px2,
        variance=footprint.dilation_px2 + footprint.filter_px2,
        void_alpha=options.void_alpha,
        stop=STOP[options.exactness],
        brightest=1.0 if options.displayed else BRIGHTEST,
        count=layers * splats,
        sh_count=sh_count,
        sh_used=sh_used,
        capacity=capacity,
        splats=splats,
        layers=layers,
        **{f"row_{a}_{b}": _limbs(float(rotation[m, n])) for m, a in enumerate("xyz") for n, b in enumerate("xyz")},
        **{f"from_{axis}": _mantissa(float(part)) for axis, part in zip("xyz", position, strict=True)},
        focal_x=_limbs(i.fx_px / FIXED_RANGE_PX),
        focal_y=_limbs(i.fy_px / FIXED_RANGE_PX),
        principal_xy=(*_fixed(i.cx_px), *_fixed(i.cy_px)),
    )


def _limbs(part: float) -> tuple[int, int, int, int]:
    """A number in [-1, 1] as three limbs of 16 bits of its size x 2^47, and whether it is negative."""
    if abs(part) > 1:  # a focal length beyond the range: the shader sees the sign and does without
        return 0, 0, 0, 1
    whole = round(abs(part) * 2.0**47)
    return whole >> 32, whole >> 16 & 0xFFFF, whole & 0xFFFF, int(part < 0)


def _fixed(part: float) -> tuple[int, int]:
    """A coordinate in pixels as two words of its 2^31-fold, two's complement; 0 beyond the range."""
    whole = round(part * 2.0**31) if abs(part) < FIXED_RANGE_PX else 0
    return whole >> 32 & 0xFFFFFFFF, whole & 0xFFFFFFFF


def _mantissa(part: float) -> tuple[int, int, int, int]:
    """A coordinate as the two words of its 53-bit mantissa, its exponent + 2048, and whether it is negative."""
    share, exponent = math.frexp(abs(part))  # share in [0.5, 1)
    whole = int(share * 2.0**53)
    return whole >> 32, whole & 0xFFFFFFFF, (exponent - 1 + 2048) if whole else 0, int(part < 0)
