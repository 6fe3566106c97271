"""How much of a difference lasts while the viewer turns.

A client's pose is not the one that its reference was drawn from, and some of a difference holds for that pose alone.
Splats are blended in the order of their depth along the camera's axis, which turns with the camera. Quantised splats
pass each other elsewhere than those of the scene do: a blob is lacking from here and is gone a degree further. To add
it there makes a good picture worse.

The viewer turns about as far between two references as a prediction is off, so the reference before tells: what was
not lacking then will not be lacking at the client's pose. A block's share is the factor by which the difference
predicts the earlier one best (least squares), after this was moved to the same camera by the depth of the client's
splats. Where much is lacking, splats have just come or moved, and all of it counts.
"""

from __future__ import annotations

import cv2
import numpy as np

from cags_common.correction import Placement
from cags_common.geometry import F32, Camera
from cags_server.reference.detail import BLOCK_PX, by_block

STEP_PX = 2
"""Every second row and column is compared."""

DOUBT = 3e-7
"""Mean squared difference, [0, 1] RGB, at which a block's share is half that of the whole picture."""

SMALL = 10**-4.4
"""Mean squared difference, [0, 1] RGB (44 dB), over the pixels of the client's splats up to which shares count; at
twice as much they no longer do: blending order is a small error.
"""

NEWS = 10.0
"""Splats have come or moved where one difference is larger than the other by more than this factor, and the earlier one
says nothing about this one. A large splat that is blended in another order brings less.
"""

WHOLE = 0.5
"""A block is sent whole where at least this share of it is found again. Even of what lasts not all is found: moving
blurs it by a sixth, and splats that move by themselves are looked for in the wrong place.
"""

FARTHEST, NEAREST = 1e4, 1e-3
"""Depths, world units, that holes and points beside the camera are given."""


class Lasting:
    """Compares each difference of a client with the one before."""

    def __init__(self) -> None:
        self._before: tuple[F32, Camera, float] | None = None  # with its mean square

    def share(self, lack: F32, camera: Camera, depth: F32) -> F32 | None:
        """The share of ``lack`` [h, w, 3], drawn from ``camera``, to be sent [h, w]; None: all of it.

        ``depth`` [h, w] is that of the client's splats from there, camera-space z; +inf where there are none.
        """
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
        share = (1 - counts * (1 - share)).astype(np.float32)
        return np.asarray(cv2.resize(share, (lack.shape[1], lack.shape[0]), interpolation=cv2.INTER_LINEAR))


def _moved(lack: F32, drawn_from: Camera, camera: Camera, depth: F32) -> tuple[F32, F32]:
    """``lack`` seen from ``camera`` at every :data:`STEP_PX`-th pixel, whose ``depth`` is given; 1 where it shows."""
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
