"""The part of a difference that remains valid while the viewer turns.

The client's pose differs from the pose of its reference, and part of a difference is valid for the reference's pose
only. Splats are blended in the order of their depth along the camera's axis, which turns with the camera. Quantised
splats change places at other angles than the original ones, so a blob that is missing at one pose may be present one
degree further. Adding it there makes a good picture worse.

Between two references the viewer turns about as far as a prediction is wrong. The previous difference therefore shows
what will remain valid. It is warped to the new camera by the depth of the client's splats; the share of each block is
the factor by which the new difference predicts the warped one best (least squares). Where the difference is large,
splats have just arrived or moved, and all of it is sent. Splats that appear in the very frame are on their way to the
client, and hardly change the difference of the whole picture: the blocks that they lie in are sent whole.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from cags_common.correction import Placement
from cags_common.correction.reach import HOLDS, apart
from cags_common.geometry import F32, Camera
from cags_common.poses import Focus
from cags_common.splats import Splats
from cags_server.reference.detail import BLOCK_PX, by_block

STEP_PX = 2
"""Distance of the rows and columns that are compared, in pixels."""

DOUBT = 3e-7
"""Mean squared difference, [0, 1] RGB, at which a block's share is half that of the whole picture."""

SMALL = 10**-4.4
"""Mean squared difference over the pixels of the client's splats, RGB in [0, 1] (44 dB), up to which shares apply. They
fade out up to twice this value, because errors of the blending order are small.
"""

NEWS = 10.0
"""Largest ratio of two consecutive mean squared differences that are comparable. Beyond it, splats have arrived or
moved; the blending order of a large splat changes the difference by less.
"""

WHOLE = 0.5
"""Share of a block found again from which on the whole block is sent. Valid differences are not found completely:
warping blurs them by a sixth, and moving splats are warped to wrong places.
"""

REACH = 3.0
"""Radius within which a splat is seen, in standard deviations."""

Blocks = NDArray[np.bool_]
"""[rows, columns] of blocks of :data:`~cags_server.reference.detail.BLOCK_PX` pixels a side."""

SOMEWHERE = Focus((0.0, 0.0, 0.0), 1.0)
"""Focus of a scene of which nothing is known."""

COMPARABLE = 0.15
"""Largest distance of the cameras of two differences that tell of each other, radians."""

FORESEEN = 8.0
"""How many times as far as two differences have been compared they are taken to hold: a prediction is wrong by about as
far as the viewer turns in so many frames.
"""

FARTHEST, NEAREST = 1e4, 1e-3
"""Depths assigned to holes and to points next to the camera, world units."""


class Lasting:
    """Compares consecutive differences of one client."""

    def __init__(self, focus: Focus = SOMEWHERE) -> None:
        """``focus``: where the scene is, by which steps aside are measured."""
        self.reach = HOLDS
        """How far from its camera the newest difference holds, radians."""
        self._focus = focus
        self._before: tuple[F32, Camera, float] | None = None  # difference, its camera and its mean square
        self._appeared: Blocks | None = None

    def share(self, lack: F32, camera: Camera, depth: F32, appeared: Blocks | None = None) -> F32 | None:
        """The share [h, w] of ``lack`` [h, w, 3], rendered from ``camera``, to send; None for all of it.

        ``depth`` [h, w] is the camera-space z of the client's splats, +inf where there are none. ``appeared``: blocks
        with splats that have just appeared, and that the client lacks. Neither this difference nor the next can be
        compared with the one before there, so all of it is sent.
        """
        appeared_before, self._appeared = self._appeared, appeared
        power = cv2.norm(lack, cv2.NORM_L2SQR) / max(3 * int(np.count_nonzero(np.isfinite(depth))), 1)
        before, self._before = self._before, (lack, camera, power)
        compared = 0.0 if before is None else self._apart(before[1], camera)
        self.reach = self._reach(compared, float(np.clip(2 - power / SMALL, 0, 1)))
        if before is None:
            return None
        lack_before, camera_before, power_before = before
        less, more = sorted((power, power_before))
        counts = float(np.clip(2 - (more if more > NEWS * less else less) / SMALL, 0, 1))
        if not counts:
            return None
        now = np.ascontiguousarray(lack[::STEP_PX, ::STEP_PX])
        earlier, seen = _moved(lack_before, camera_before, camera, depth[::STEP_PX, ::STEP_PX])
        now *= seen[..., None]
        together, alone = (by_block(now, other, BLOCK_PX // STEP_PX) for other in (earlier, now))
        whole = together.sum() / max(alone.sum(), DOUBT)
        share = np.clip((together + DOUBT * whole) / (alone + DOUBT) / WHOLE, 0, 1)
        for blocks in (appeared, appeared_before):
            if blocks is not None:
                share[blocks] = 1
        share = (1 - counts * (1 - share)).astype(np.float32)
        return np.asarray(cv2.resize(share, (lack.shape[1], lack.shape[0]), interpolation=cv2.INTER_LINEAR))

    def _apart(self, before: Camera, camera: Camera) -> float:
        return apart(before.pose, camera.pose, self._focus.centre, self._focus.radius)

    def _reach(self, compared: float, smallness: float) -> float:
        """Of a difference that was ``compared`` with one so far away, radians, and is small to this extent."""
        known = FORESEEN * compared if compared <= COMPARABLE else 0.0
        return HOLDS - smallness * (HOLDS - min(known, HOLDS))


def blocks_of(splats: Splats, camera: Camera) -> Blocks:
    """The blocks of a picture from ``camera`` that ``splats`` may be seen in."""
    intrinsics = camera.intrinsics
    rotation, shift = camera.world_to_camera
    x, y, z = rotation @ splats.means.astype(np.float64).T + shift[:, None]
    ahead = z > camera.near
    x, y, z = x[ahead], y[ahead], z[ahead]
    radius = REACH * np.exp(splats.log_scales[ahead].max(axis=1)) / z
    spans = []
    for middle, reach, side in (
        (intrinsics.fy_px * y / z + intrinsics.cy_px, intrinsics.fy_px * radius, camera.height_px),
        (intrinsics.fx_px * x / z + intrinsics.cx_px, intrinsics.fx_px * radius, camera.width_px),
    ):
        count = -(-side // BLOCK_PX)
        first, last = np.floor((middle - reach) / BLOCK_PX), np.floor((middle + reach) / BLOCK_PX) + 1
        spans.append((first.clip(0, count).astype(np.intp), last.clip(0, count).astype(np.intp), count))
    (top, bottom, rows), (left, right, columns) = spans
    edges = np.zeros((rows + 1, columns + 1), np.int64)  # sums from the corner count the rectangles over a block
    for at, sign in (((top, left), 1), ((bottom, right), 1), ((top, right), -1), ((bottom, left), -1)):
        np.add.at(edges, at, sign)
    return np.asarray(edges.cumsum(0).cumsum(1)[:rows, :columns] > 0)


def _moved(lack: F32, drawn_from: Camera, camera: Camera, depth: F32) -> tuple[F32, F32]:
    """``lack`` warped to every :data:`STEP_PX`-th pixel of ``camera``, by the ``depth`` of these pixels; and a mask, 1
    where the warped pixel lies inside the picture.
    """
    m = Placement(camera, drawn_from).matrix.astype(np.float32)
    rows, columns = (np.arange(count, dtype=np.float32) * STEP_PX + 0.5 for count in depth.shape)
    far = np.nan_to_num(depth, nan=FARTHEST, posinf=FARTHEST).clip(NEAREST, FARTHEST)
    x, y, z = ((m[i, 0] * columns + (m[i, 1] * rows + m[i, 2])[:, None]) * far + m[i, 3] for i in range(3))
    ahead = z > NEAREST
    z = np.where(ahead, z, 1)
    x, y = x / z - 0.5, y / z - 0.5
    height, width = lack.shape[:2]
    seen = ahead & (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
    x, y = (np.where(seen, at, -2).astype(np.float32) for at in (x, y))
    moved = cv2.remap(lack, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=(0, 0, 0))
    return np.asarray(moved, np.float32), seen.astype(np.float32)
