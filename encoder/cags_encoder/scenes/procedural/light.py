"""The room's light, baked: sun through the window, sky from the window, a lamp, and bounced light.

Irradiance is linear RGB. Occluders are upright boxes and balls, which also approximate curved objects.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cags_common.geometry import F64, Vec3

SKY = np.array([0.62, 0.78, 1.0]) * 5.0
SUN = np.array([1.0, 0.82, 0.58]) * 3.4
LAMP = np.array([1.0, 0.66, 0.36]) * 0.55
AMBIENT = np.array([0.42, 0.40, 0.38])
BOUNCE = np.array([0.34, 0.25, 0.17])
"""Sunlight reflected by the floor, for surfaces that face down or sideways."""

AMBIENT_REACH = 0.7
"""Range of ambient occlusion, metres."""

_LIFT = 0.012
"""Distance from the surface at which rays begin, in metres, so that a surface does not shade itself."""


@dataclass(frozen=True)
class Lighting:
    """The lights and their occluders."""

    window: tuple[Vec3, Vec3, Vec3]  # corner, edge, edge of the opening; metres
    panes: tuple[int, int]  # the window's panes along its edges, divided by bars
    sun: Vec3  # unit direction towards the sun
    lamp: Vec3  # position, metres
    boxes: F64  # [B, 2, 3] low and high corners, metres
    balls: F64  # [S, 4] centre and radius, metres

    def soft(self, points: F64, normals: F64) -> F64:
        """Smooth part of the irradiance [N, 3] at ``points`` [N, 3] with unit ``normals``: everything but the sun."""
        ambient = self._openness(points, normals)[:, None]
        from_below = (0.5 - 0.5 * normals[:, 1:2]) + 0.35
        indirect: F64 = ambient * (AMBIENT + BOUNCE * from_below)
        return indirect + SKY * self._sky(points, normals)[:, None] + LAMP * self._lamp(points, normals)[:, None]

    def at_moving(self, points: F64, normals: F64) -> F64:
        """The soft part [N, 3] for moving objects: like :meth:`soft`, but without occluders."""
        corner, edge_u, edge_v = (np.asarray(v) for v in self.window)
        to = corner + 0.5 * (edge_u + edge_v) - points
        distance = np.linalg.norm(to, axis=1)
        area = float(np.linalg.norm(np.cross(edge_u, edge_v)))
        # A wide source also lights surfaces that face slightly away from it.
        wrapped = np.maximum(np.sum(to * normals, axis=1) / distance + 0.2, 0.0) / 1.2
        sky = wrapped * area / (np.pi * (distance**2 + area / np.pi))
        from_below = (0.5 - 0.5 * normals[:, 1:2]) + 0.35
        soft: F64 = AMBIENT + BOUNCE * from_below + SKY * sky[:, None]
        return soft

    def sunlight(self, points: F64, normals: F64) -> F64:
        """Irradiance [N, 3] by the sun, which only comes through the panes."""
        cosine = np.maximum(normals @ np.asarray(self.sun), 0.0)
        out = np.zeros(len(points))
        candidates = np.flatnonzero((cosine > 0) & (self._through_panes(points) > 0))
        if len(candidates):
            at = points[candidates] + _LIFT * normals[candidates]
            rays = np.broadcast_to(np.asarray(self.sun), at.shape)
            clear = self._clear(at, rays, np.inf)
            out[candidates] = cosine[candidates] * clear * self._through_panes(points[candidates])
        return out[:, None] * SUN

    def highlight_axes(self, points: F64, normals: F64) -> tuple[F64, F64]:
        """Mirror image of the window: viewing directions [N, 3] (camera to surface) and strengths [N]."""
        corner, edge_u, edge_v = (np.asarray(v) for v in self.window)
        to_light = _unit(corner + 0.5 * (edge_u + edge_v) - points)
        cosine = np.sum(normals * to_light, axis=1)
        mirrored = 2 * cosine[:, None] * normals - to_light  # from the surface towards the eye that sees it
        return -mirrored, np.sqrt(np.maximum(cosine, 0.0))

    def _through_panes(self, points: F64) -> F64:
        """1 if the ray to the sun passes a pane, 0 at the bars and outside the frame, smooth in the penumbra."""
        corner, edge_u, edge_v = (np.asarray(v) for v in self.window)
        normal = np.cross(edge_u, edge_v)
        toward = float(normal @ np.asarray(self.sun))
        t = (corner - points) @ normal / toward
        hit = points + np.maximum(t, 0.0)[:, None] * np.asarray(self.sun) - corner
        share = np.where(t > 0, 1.0, 0.0)
        for edge, panes in ((edge_u, self.panes[0]), (edge_v, self.panes[1])):
            length = float(np.linalg.norm(edge))
            along = hit @ edge / length**2 * panes
            inside = (along > 0) & (along < panes)
            to_bar = np.abs(along - np.round(along)) * length / panes  # metres from the nearest bar or jamb
            share = share * inside * np.clip((to_bar - 0.02) / 0.02, 0.0, 1.0)
        return np.asarray(share, np.float64)

    def _sky(self, points: F64, normals: F64) -> F64:
        """Form factor of the window [N], from twelve samples."""
        corner, edge_u, edge_v = (np.asarray(v) for v in self.window)
        face = _unit(np.cross(edge_u, edge_v)[None])[0]
        area = float(np.linalg.norm(np.cross(edge_u, edge_v)))
        total = np.zeros(len(points))
        for i in range(3):
            for j in range(4):
                target = corner + (i + 0.5) / 3 * edge_u + (j + 0.5) / 4 * edge_v
                to = target - points
                distance = np.maximum(np.linalg.norm(to, axis=1), 0.25)
                to = to / distance[:, None]
                weight = np.maximum(np.sum(to * normals, axis=1), 0) * np.abs(to @ face) / (np.pi * distance**2)
                lit = np.flatnonzero(weight > 1e-5)
                start = points[lit] + _LIFT * normals[lit]
                total[lit] += weight[lit] * self._clear(start, to[lit], distance[lit] - 0.1)
        form_factor: F64 = total * area / 12
        return form_factor

    def _lamp(self, points: F64, normals: F64) -> F64:
        """Irradiance factor [N] of the lamp: a small ball, softened at short range."""
        to = np.asarray(self.lamp) - points
        distance = np.linalg.norm(to, axis=1)
        to = to / np.maximum(distance, 1e-6)[:, None]
        cosine = np.maximum(np.sum(to * normals, axis=1), 0.0)
        clear = self._clear(points + _LIFT * normals, to, distance - 0.3)
        factor: F64 = cosine * clear / (0.12 + distance**2)
        return factor

    def _openness(self, points: F64, normals: F64) -> F64:
        """Ambient occlusion [N]: openness of the hemisphere at short range, in twenty cosine-weighted directions."""
        k = np.arange(20) + 0.5
        radius, azimuth = np.sqrt(k / 20), np.pi * (1 + 5**0.5) * k
        local = np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), np.sqrt(1 - radius**2)], axis=1)
        helper = np.where(np.abs(normals[:, 1:2]) < 0.9, (0.0, 1.0, 0.0), (1.0, 0.0, 0.0))
        tangent = _unit(np.cross(normals, helper))
        frame = np.stack([tangent, np.cross(normals, tangent), normals], axis=1)  # [N, 3, 3] rows: the local axes
        start = points + _LIFT * normals
        open_ = np.zeros(len(points))
        for direction in local:
            ray = direction @ frame
            open_ += np.minimum(self._distance(start, ray), AMBIENT_REACH) / AMBIENT_REACH
        openness: F64 = np.sqrt(open_ / len(local))
        return openness

    def _clear(self, start: F64, ray: F64, reach: F64 | float) -> NDArray[np.bool_]:
        """Whether each ray is free for ``reach`` [N] metres."""
        return self._distance(start, ray) >= reach

    def _distance(self, start: F64, ray: F64) -> F64:
        """Distance [N] along unit rays to the nearest occluder, inf without one."""
        origin, inverse = np.ascontiguousarray(start.T), 1.0 / np.where(np.abs(ray.T) < 1e-9, 1e-9, ray.T)
        nearest = np.full(len(start), np.inf)
        for low, high in self.boxes:
            entry, leave = _slab(low[0], high[0], origin[0], inverse[0])
            for axis in (1, 2):
                near, far = _slab(low[axis], high[axis], origin[axis], inverse[axis])
                entry, leave = np.maximum(entry, near), np.minimum(leave, far)
            nearest = np.where((entry <= leave) & (entry > 0), np.minimum(entry, nearest), nearest)
        for x, y, z, radius in self.balls:
            offset = np.array([x, y, z]) - start
            along = np.einsum("ni,ni->n", offset, ray)
            under = radius**2 - (np.einsum("ni,ni->n", offset, offset) - along**2)
            entry = along - np.sqrt(np.maximum(under, 0.0))
            nearest = np.where((under > 0) & (entry > 0), np.minimum(entry, nearest), nearest)
        return nearest


def _slab(low: float, high: float, origin: F64, inverse: F64) -> tuple[F64, F64]:
    """Distances at which rays enter and leave the space between two planes."""
    a, b = (low - origin) * inverse, (high - origin) * inverse
    return np.minimum(a, b), np.maximum(a, b)


def _unit(vectors: F64) -> F64:
    units: F64 = vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)
    return units


def shown(linear: F64) -> F64:
    """Display-referred RGB of linear light: an exponential shoulder, then the display's gamma."""
    display: F64 = (1.0 - np.exp(-1.15 * np.maximum(linear, 0.0))) ** (1 / 2.2)
    return display
