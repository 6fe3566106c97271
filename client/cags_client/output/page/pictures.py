"""The pictures that a page may ask for, by name."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from cags_client.output.page.controls import ShownFrame
from cags_common.geometry import F32, Camera
from cags_common.metrics import psnr

U8 = NDArray[np.uint8]

PICTURES = ("restored", "distorted", "correction", "reference", "truth", "error", "depth")
"""In the order of the page's menus. ``correction`` is what the reference changed, ``error`` the difference of restored
and truth, ``depth`` is coloured.
"""

NEED_TRUTH = ("truth", "error")

ERROR_GAIN = 4.0
"""How much the difference is brightened: 1/4 of the range is full scale."""


class Gallery:
    """The pictures of one displayed frame, made when first asked for, as even-sized uint8 RGB [H, W, 3]."""

    def __init__(self, shown: ShownFrame, truth: Callable[[int, Camera], F32] | None) -> None:
        self.shown = shown
        self._render_truth = truth
        self._truth: F32 | None = None
        self._made: dict[str, U8 | None] = {}

    def picture(self, name: str) -> U8 | None:
        """One of :data:`PICTURES`, or None where this frame has none of it."""
        if name not in self._made:
            self._made[name] = self._make(name)
        return self._made[name]

    def truth(self) -> F32 | None:
        """The unquantised scene from the same camera, rendered once."""
        if self._truth is None and self._render_truth is not None:
            self._truth = self._render_truth(self.shown.frame, self.shown.camera)
        return self._truth

    def scores(self) -> dict[str, float]:
        """PSNR in dB against the truth, of the pictures that were made with one."""
        if self._truth is None:
            return {}
        compared = {name: self.shown.pictures.get(name) for name in ("restored", "distorted")}
        return {
            f"psnr_{n}_db": round(psnr(image, self._truth), 2) for n, image in compared.items() if image is not None
        }

    def _make(self, name: str) -> U8 | None:
        if name == "depth":
            depth = self.shown.depth
            return None if depth is None else _even(coloured_depth(depth))
        if name in NEED_TRUTH:
            truth = self.truth()
            if truth is None:
                return None
            return _even(_bytes(truth) if name == "truth" else coloured_error(self.shown.pictures["restored"], truth))
        image = self.shown.pictures.get(name)
        return None if image is None else _even(_bytes(image))


def coloured_depth(depth: F32) -> U8:
    """Depth [H, W] as colours: near is warm, far is cool, void is black. Inverse depth, 2nd to 98th percentile."""
    solid = np.isfinite(depth) & (depth > 0)
    if not solid.any():
        return np.zeros((*depth.shape, 3), np.uint8)
    inverse = np.divide(1.0, depth, out=np.zeros_like(depth), where=solid)
    low, high = np.percentile(inverse[solid][::16], [2, 98])
    level = np.clip((inverse - low) / max(float(high - low), 1e-9) * 255, 0, 255).astype(np.uint8)
    colours = cv2.cvtColor(cv2.applyColorMap(level, cv2.COLORMAP_TURBO), cv2.COLOR_BGR2RGB)
    colours[~solid] = 0
    return np.asarray(colours, dtype=np.uint8)


def coloured_error(image: F32, truth: F32) -> U8:
    """Largest difference over the channels [H, W] as colours: black is equal, bright is far off."""
    difference = np.abs(image - truth).max(axis=2) * np.float32(ERROR_GAIN * 255)
    level = np.clip(difference, 0, 255).astype(np.uint8)
    return np.asarray(cv2.cvtColor(cv2.applyColorMap(level, cv2.COLORMAP_INFERNO), cv2.COLOR_BGR2RGB), dtype=np.uint8)


def _bytes(image: F32) -> U8:
    return np.asarray(cv2.convertScaleAbs(image, alpha=255.0), dtype=np.uint8)


def _even(image: U8) -> U8:
    """4:2:0 video wants even sizes: the last row or column goes."""
    height, width = image.shape[:2]
    return image[: max(2, height - height % 2), : max(2, width - width % 2)]
