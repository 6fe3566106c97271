"""Scoring without disturbing the display: pictures go to a temporary file while playing, and are scored afterwards."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cags_client.pipeline import PresentedFrame
from cags_client.present.base import FrameStats
from cags_client.present.files import bytes_of
from cags_client.score import score_pictures
from cags_common.geometry import F32, Camera

Truth = Callable[[int, Camera], tuple[F32, F32]]
"""Media frame and camera to the true picture [H, W, 3] and its alpha [H, W]."""

_NAMES = ("distorted", "aligned", "restored")


@dataclass(frozen=True, eq=False)
class _Spooled:
    frame: int
    camera: Camera
    offset: int
    names: tuple[str, ...]


class ScoringSpool:
    """Spools the pictures of every frame as bytes (uint8: scores above 58 dB are not told apart)."""

    def __init__(self) -> None:
        self._file = tempfile.TemporaryFile(prefix="cags-spool-")  # noqa: SIM115 - closed with the spool
        self._frames: list[_Spooled] = []
        self._end = 0

    def show(self, presented: PresentedFrame, stats: FrameStats) -> None:
        """See :class:`cags_client.present.base.FrameSink`."""
        aligned = presented.aligned.rgb if presented.aligned is not None else None
        pictures = dict(zip(_NAMES, (presented.distorted, aligned, presented.rgb), strict=True))
        held = {name: picture for name, picture in pictures.items() if picture is not None}
        self._frames.append(_Spooled(presented.frame, presented.camera, self._end, tuple(held)))
        for picture in held.values():
            self._end += self._file.write(bytes_of(picture).tobytes())

    def close(self, *, completed: bool) -> None:
        """Keep what is spooled for :meth:`scores` if ``completed``."""
        if not completed:
            self._file.close()

    def scores(self, truth: Truth) -> Iterator[tuple[int, dict[str, Any], NDArray[np.uint8]]]:
        """Frame, its scores and the true picture as bytes, in the order of display. The spool is used up."""
        with self._file:
            for item in self._frames:
                rgb, alpha = truth(item.frame, item.camera)
                pictures = self._read(item)
                scores = score_pictures(
                    pictures["distorted"], pictures.get("aligned"), pictures["restored"], rgb, alpha
                )
                yield item.frame, dict(scores), bytes_of(rgb)

    def __len__(self) -> int:
        return len(self._frames)

    def _read(self, item: _Spooled) -> dict[str, F32]:
        shape = (item.camera.height_px, item.camera.width_px, 3)
        size = int(np.prod(shape))
        self._file.seek(item.offset)
        return {
            name: np.frombuffer(self._file.read(size), np.uint8).reshape(shape).astype(np.float32) / np.float32(255)
            for name in item.names
        }
