"""The part of a difference that remains valid while the viewer turns.

The client's pose differs from the pose of its reference, and part of a difference is valid for the reference's pose
only. Splats are blended in the order of their depth along the camera's axis, which turns with the camera. Quantised
splats change places at other angles than the original ones, so a blob that is missing at one pose may be present one
degree further. Adding it there makes a good picture worse.

Between two references the viewer turns about as far as a prediction is wrong. The previous difference therefore shows
what will remain valid. It is warped to the new camera by the depth of the client's splats; the share of each block is
the factor by which the new difference predicts the warped one best (least squares). Where the difference is large,
splats have just arrived or moved, and all of it is sent. Splats that the client lacks, because they appear in the very
frame, are small in the whole picture: there it is the blocks that are compared.
"""

from __future__ import annotations

import cv2
import numpy as np

from cags_common.correction import Placement
from cags_common.geometry import F32, Camera
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

FARTHEST, NEAREST = 1e4, 1e-3
"""Depths assigned to holes and to points next to the camera, world units."""


class Lasting:
    """Compares consecutive differences of one client."""

    def __init__(self) -> None:
        self._before: tuple[F32, Camera, float] | None = None  # difference, its camera and its mean square
        self._appeared = False

    def share(self, lack: F32, camera: Camera, depth: F32, *, appeared: bool = False) -> F32 | None:
        """The share [h, w] of ``lack`` [h, w, 3], rendered from ``camera``, to send; None for all of it.

        ``depth`` [h, w] is the camera-space z of the client's splats, +inf where there are none. ``appeared``: the
        scene shows splats that the client does not have, or the other way round; blocks whose difference is
        :data:`NEWS` times that of before, or less than a part of it, are then sent whole. Without such splats the same
        ratio comes from the blending order.
        """
        appeared, self._appeared = appeared or self._appeared, appeared
        power = cv2.norm(lack, cv2.NORM_L2SQR) / max(3 * int(np.count_nonzero(np.isfinite(depth))), 1)
        before, self._before = self._before, (lack, camera, power)
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
        if appeared:
            past = by_block(earlier, earlier, BLOCK_PX // STEP_PX) + DOUBT
            share[(alone > NEWS * past) | (past > NEWS * (alone + DOUBT))] = 1
        share = (1 - counts * (1 - share)).astype(np.float32)
        return np.asarray(cv2.resize(share, (lack.shape[1], lack.shape[0]), interpolation=cv2.INTER_LINEAR))


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
