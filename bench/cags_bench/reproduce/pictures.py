"""Pictures for the page: what a viewer saw at one frame, beside the truth, small enough to be embedded."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np

from cags_bench.film.film import Truth
from cags_client.frame.presented import PresentedFrame
from cags_common.geometry import F32

QUALITY = 88
"""Of JPEG: its errors are far under those that are to be seen."""

SHOWN_SHARE = 0.5
"""Side of the middle of the picture that is shown at full resolution, as a share."""


class Snapshot:
    """Keeps one frame of a session, and its truth."""

    def __init__(self, truth: Truth, frame: int) -> None:
        self._truth, self._frame = truth, frame
        self.pictures: dict[str, str] = {}
        """``shown`` and ``truth``, as base64 JPEG; empty when the frame was never shown."""

    def watch(self, presented: PresentedFrame, record: dict[str, Any]) -> None:
        """See :data:`cags_bench.sim.session.Watcher`."""
        del record
        if presented.frame != self._frame:
            return
        truth, _ = self._truth(presented.frame, presented.camera)
        self.pictures = {"shown": jpeg(middle(presented.rgb)), "truth": jpeg(middle(truth))}


def middle(rgb: F32) -> F32:
    """The middle of a picture [H, W, 3]."""
    h, w = rgb.shape[:2]
    dy, dx = (round(side * (1 - SHOWN_SHARE) / 2) for side in (h, w))
    return rgb[dy : h - dy, dx : w - dx]


def jpeg(rgb: F32) -> str:
    """A picture [H, W, 3] in [0, 1] as base64 JPEG."""
    import cv2

    bgr = np.ascontiguousarray((rgb.clip(0, 1) * 255 + 0.5).astype(np.uint8)[..., ::-1])
    _, data = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    return base64.b64encode(data.tobytes()).decode("ascii")
