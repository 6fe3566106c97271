"""The field-of-view seam: how much wider than the client's view the reference is rendered.

With margins ``s = (s_x, s_y)`` the reference covers ``(1 + s_x) F_x`` by ``(1 + s_y) F_y`` (angles; the paper,
section 4.4).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

from cags_common.geometry import Intrinsics, Pose
from cags_server.predict.base import PoseDistribution

MAX_REFERENCE_FOV_RAD = math.radians(160.0)
"""Widest reference: beyond it a pinhole image spends its pixels on the rim."""


@dataclass(frozen=True, slots=True)
class FovObservation:
    """What a field-of-view policy may look at when frame ``frame`` is planned."""

    frame: int
    predicted: PoseDistribution
    client: Intrinsics


class FovPolicy(Protocol):
    """Decides the margins. One object a client; it may keep state between frames."""

    def scale(self, observation: FovObservation) -> tuple[float, float]:
        """Margins (s_x, s_y), each at least 0 and finite."""
        ...

    def truth(self, frame: int, predicted: Pose, actual: Pose, client: Intrinsics) -> None:
        """The true pose of an earlier frame has become known."""
        ...


def client_halves(client: Intrinsics) -> tuple[float, float]:
    """Half angles of a centred view that covers the client's, horizontally and vertically."""
    return (
        math.atan(max(client.cx_px, client.width_px - client.cx_px) / client.fx_px),
        math.atan(max(client.cy_px, client.height_px - client.cy_px) / client.fy_px),
    )


def widened(client: Intrinsics, margins: tuple[float, float], width_px: int, height_px: int) -> Intrinsics:
    """Intrinsics of a centred reference image whose angles are the client's times (1 + margin), within bounds.

    A client whose principal point is off centre is covered by a view that reaches as far on both sides as the
    client's wider side. The result never reaches ``MAX_REFERENCE_FOV_RAD`` unless the client's field of view does.
    """
    full = [2 * half for half in client_halves(client)]
    wide = [min(fov * (1 + max(0.0, s)), max(fov, MAX_REFERENCE_FOV_RAD)) for fov, s in zip(full, margins, strict=True)]
    return Intrinsics.of_fov(width_px, height_px, wide[0], wide[1])
