"""Scoring without disturbing the display: pictures go to a temporary file while playing, and are scored afterwards."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cags_client.frame.presented import PresentedFrame
from cags_client.output.files import PictureSpool, Spooled, bytes_of
from cags_client.output.score import score_pictures
from cags_client.output.sinks import FrameStats
from cags_common.geometry import F32, Camera

Truth = Callable[[int, Camera], tuple[F32, F32]]
"""Media frame and camera to the true picture [H, W, 3] and its alpha [H, W]."""

_NAMES = ("distorted", "aligned", "restored")


@dataclass(frozen=True, eq=False)
class _Spooled:
    frame: int
    camera: Camera
    pictures: dict[str, Spooled]


class ScoringSpool:
    """Spools the pictures of every frame as bytes (uint8: scores above 58 dB are not told apart)."""

    def __init__(self) -> None:
        self._spool = PictureSpool()
        self._frames: list[_Spooled] = []

    def show(self, presented: PresentedFrame, stats: FrameStats) -> None:
        """See :class:`cags_client.output.sinks.FrameSink`."""
        pictures = dict(zip(_NAMES, (presented.distorted, presented.aligned_rgb, presented.rgb), strict=True))
        spooled = {
            name: self._spool.put(bytes_of(picture)) for name, picture in pictures.items() if picture is not None
        }
        self._frames.append(_Spooled(presented.frame, presented.camera, spooled))

    def close(self, *, completed: bool) -> None:
        """Keep what is spooled for :meth:`scores` if ``completed``."""
        if not completed:
            self._spool.close()

    def scores(self, truth: Truth) -> Iterator[tuple[int, dict[str, Any], NDArray[np.uint8]]]:
        """Frame, its scores and the true picture as bytes, in the order of display. The spool is used up."""
        with self._spool:
            for item in self._frames:
                rgb, alpha = truth(item.frame, item.camera)
                pictures = {name: self._picture(spooled) for name, spooled in item.pictures.items()}
                scores = score_pictures(
                    pictures["distorted"], pictures.get("aligned"), pictures["restored"], rgb, alpha
                )
                yield item.frame, dict(scores), bytes_of(np.clip(rgb, 0.0, 1.0))

    def __len__(self) -> int:
        return len(self._frames)

    def _picture(self, spooled: Spooled) -> F32:
        return self._spool.take(spooled).astype(np.float32) / np.float32(255)
