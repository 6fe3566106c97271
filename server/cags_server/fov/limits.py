"""Views for which a reference can be drawn."""

from __future__ import annotations

import math

from cags_common.geometry import MAX_FOV_RAD, Intrinsics
from cags_common.video.h264 import MAX_PIXELS
from cags_server.fov.base import client_halves

MIN_FOV_RAD = math.radians(0.5)
"""Narrowest view that is drawn: focal lengths of references of up to 4,096 pixels then fit the wire's bounds."""


def undrawable(view: Intrinsics, *, full_size: bool) -> str | None:
    """Why no reference can be drawn for a client's ``view``, in a line; None where one can.

    With ``full_size`` references are as large as the client's pictures.
    """
    narrowest_rad, widest_rad = (2 * half for half in sorted(client_halves(view)))
    if narrowest_rad < MIN_FOV_RAD:
        narrowest, least = math.degrees(narrowest_rad), math.degrees(MIN_FOV_RAD)
        return f"the view spans {narrowest:.2g} degrees; at least {least:g} are drawn"
    if widest_rad > MAX_FOV_RAD:
        widest, most = math.degrees(widest_rad), math.degrees(MAX_FOV_RAD)
        return f"the view spans {widest:.2f} degrees; a pinhole camera draws {most:.0f} at most"
    width, height = view.width_px // 2 * 2, view.height_px // 2 * 2
    if full_size and not (width and height and width * height <= MAX_PIXELS):
        return f"pictures of {view.width_px}x{view.height_px} cannot be coded; at most {MAX_PIXELS} pixels are"
    return None
