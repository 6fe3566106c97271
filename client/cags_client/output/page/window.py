"""What is drawn for a page's window: its shape, as many of its pixels as the client's settings allow, and all of the
scene that they show.
"""

from __future__ import annotations

import math

from cags_client.settings import ClientSettings

NARROWEST, LEAST_PX = 0.25, 16
"""Of a window's sides, one to the other; and of a picture's side."""

WIDEST_TAN = 1.0
"""Tangent of half the widest angle, 90 degrees, to which a view grows for a window of another shape."""


def windowed(settings: ClientSettings, width: int, height: int) -> tuple[int, int, float]:
    """Width and height, pixels, and horizontal angle, degrees, of pictures for a window of so many pixels.

    No more pixels than ``settings`` have; even sides, as 4:2:0 wants them. The angles hold those of ``settings``, so
    that heads are not cut off; where one would grow beyond 90 degrees, both shrink until it does not.
    """
    aspect = min(max(width / height, NARROWEST), 1 / NARROWEST)
    high = min(height, width / aspect, math.sqrt(settings.width * settings.height / aspect))
    size = _even(high * aspect), _even(high)
    aspect = size[0] / size[1]
    tan_x = math.tan(math.radians(settings.fov) / 2)
    tan_y = tan_x * settings.height / settings.width
    held = max(tan_x, aspect * tan_y)
    widest = max(WIDEST_TAN, tan_x, tan_y)
    held = min(held, widest, widest * aspect)
    return *size, math.degrees(2 * math.atan(held))


def _even(px: float) -> int:
    return max(LEAST_PX, 2 * int(px / 2))
