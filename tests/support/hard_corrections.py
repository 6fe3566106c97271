"""Views that are hard to correct, and places from which references are hard to bring over."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from cags_common.correction import Reference, compand
from cags_common.geometry import Camera
from cags_common.raster import RenderedView
from support.corrections import F, camera, empty_view, flat_view, view

CLIENT = camera((160, 120))


def server(size: tuple[int, int] = (80, 60), **where: object) -> Camera:
    return camera(size, **{"fov_rad": 1.4, **where})  # type: ignore[arg-type]


def specks() -> RenderedView:
    """Floaters: single pixels and thin lines at any depth, half transparent."""
    rng = np.random.default_rng(7)
    drawn = view(CLIENT)
    depth, alpha = drawn.depth.copy(), drawn.alpha.copy()
    at = rng.random(depth.shape) < 0.2
    depth[at] = 10 ** rng.uniform(-3, 4, at.sum())
    alpha[at] = rng.random(at.sum())
    depth[::17] = 0.05
    return replace(drawn, depth=depth, alpha=alpha)


def poisoned() -> RenderedView:
    """What no rasteriser should give."""
    rng = np.random.default_rng(8)
    drawn = view(CLIENT)
    depth = rng.choice(
        np.array([np.nan, np.inf, -np.inf, 0.0, -1.0, 1e-38, 1e-20, 1e20, 3e38, 2.0], F), drawn.depth.shape
    )
    return replace(drawn, depth=depth, rgb=drawn.rgb * F(1e30))


def missing_square() -> tuple[RenderedView, Reference]:
    """A square that no splat covers in a wall at 3 m, and a difference that has it: together all is 0.5."""
    there = server((160, 120), at=(0.3, 0.0, 0.0))
    drawn = flat_view(CLIENT, 3.0)
    alpha, rgb = drawn.alpha.copy(), drawn.rgb.copy()
    alpha[50:70, 70:90], rgb[50:70, 70:90] = 0, 0
    missing = RenderedView(rgb, alpha, np.where(alpha > 0, drawn.depth, np.inf).astype(F), None)
    lack = np.zeros((120, 160, 3))
    i, j = CLIENT.intrinsics, there.intrinsics
    left, right = (((u - i.cx_px) / i.fx_px * 3.0 - 0.3) / 3.0 * j.fx_px + j.cx_px for u in (70, 90))
    top, bottom = ((v - i.cy_px) / i.fy_px * j.fy_px + j.cy_px for v in (50, 70))
    lack[round(top) : round(bottom), round(left) : round(right)] = 0.5
    return missing, Reference(compand(lack, 0.1).astype(F), there)


VIEWS = {
    "usual": view(CLIENT),
    "holes": view(CLIENT, holes=0.4),
    "all but empty": view(CLIENT, holes=0.98),
    "empty": empty_view(CLIENT),
    "floaters": specks(),
    "poisoned": poisoned(),
    "at the near plane": flat_view(CLIENT, 0.2),
    "very far": flat_view(CLIENT, 9e5),
}

TIES, USUAL_TIES = {"floaters": 0.02, "poisoned": 0.02}, 2e-3
"""Share of the pixels that may be another: where depths jump at every pixel, z-tests hang on rounding."""

PLACES = {
    "the same": server(),
    "a step of 1 m": server(at=(1.0, 0.0, 0.0)),
    "a step of 1 m forward": server(at=(0.0, 0.0, 1.0)),
    "60 degrees": server(turned_rad=math.radians(60)),
    "1 m and 60 degrees": server(at=(-0.8, 0.3, 0.5), turned_rad=math.radians(60)),
    "behind": server(turned_rad=math.pi),
    "behind the wall": server(at=(0.0, 0.0, 10.0)),
    "in the wall": server(at=(0.0, 0.0, 3.0)),
    "far away": server(at=(1e6, 0.0, 0.0)),
    "narrow": server(fov_rad=0.1),
    "wide": server(fov_rad=2.9),
}
