"""Films of the displayed and of the true pictures, at the clip's frame rate."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from cags_client.frame.presented import PresentedFrame
from cags_client.output.files import bytes_of
from cags_common.errors import OutputError
from cags_common.geometry import F32, Camera

Picture = NDArray[np.uint8]
"""[H, W, 3] RGB."""

Truth = Callable[[int, Camera], tuple[F32, F32]]
"""Picture [H, W, 3] and alpha [H, W] of a frame from a camera."""


class RawVideo:
    """Pictures of one size [H, W, 3] in a file, one after another (``rgb24`` in ffmpeg)."""

    def __init__(self, path: Path) -> None:
        self.path, self.count = path, 0
        self.shape: tuple[int, int, int] = (0, 0, 3)
        self._file: IO[bytes] = path.open("wb")

    def add(self, picture: Picture) -> None:
        """Append a picture. Raises :class:`OutputError` if the disk is full."""
        self.shape = (picture.shape[0], picture.shape[1], 3)
        try:
            self._file.write(np.ascontiguousarray(picture).data)
        except OSError as error:
            raise OutputError.of(self.path, error) from error
        self.count += 1

    def close(self) -> None:
        """Finish writing, so that the file can be read."""
        self._file.close()

    def pictures(self) -> NDArray[np.uint8]:
        """All pictures [F, H, W, 3], memory-mapped."""
        if not self.count:
            return np.zeros((0, *self.shape), np.uint8)
        return np.memmap(self.path, np.uint8, "r", shape=(self.count, *self.shape))


@dataclass(frozen=True)
class Film:
    """Two videos of equal length and size: ``shown`` and ``truth``."""

    shown: RawVideo
    truth: RawVideo
    fps: float
    frames: tuple[int, ...]
    """Media frame at each position. Skipped frames are included; they repeat the previous picture."""

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        return self.shown.shape[1], self.shown.shape[0]

    def pairs(self) -> Iterator[tuple[Picture, Picture]]:
        """Shown and true picture of every frame."""
        return zip(self.shown.pictures(), self.truth.pictures(), strict=True)


class FilmMaker:
    """Records the film of a session in a temporary folder.

    A skipped frame repeats the previous picture, as on a display. Its truth is rendered from a camera between its
    neighbours', so a freeze appears in the film as viewers see it.
    """

    def __init__(self, truth: Truth, fps: float) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="cags-film-")
        self._shown, self._true = (RawVideo(Path(self._folder.name) / name) for name in ("shown.rgb", "truth.rgb"))
        self._truth, self._fps = truth, fps
        self._frames: list[int] = []
        self._last: tuple[Camera, Picture] | None = None

    def __enter__(self) -> FilmMaker:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._shown.close()
        self._true.close()
        self._folder.cleanup()

    def watch(self, presented: PresentedFrame, record: dict[str, Any]) -> None:
        """Take a frame (:data:`cags_bench.sim.session.Watcher`)."""
        del record
        self.show(presented.frame, presented.camera, bytes_of(presented.rgb))

    def show(self, frame: int, camera: Camera, picture: Picture) -> None:
        """From media frame ``frame`` on, the display shows ``picture``, seen from ``camera``. Frames come in order."""
        if self._last is not None:
            last_camera, held = self._last
            missing = range(self._frames[-1] + 1, frame)
            for number, between in enumerate(missing, start=1):
                share = number / (len(missing) + 1)
                self._add(between, replace(camera, pose=last_camera.pose.towards(camera.pose, share)), held)
        self._add(frame, camera, picture)
        self._last = camera, picture

    def film(self, end: int | None = None) -> Film:
        """The whole film up to media frame ``end`` (excluded), which may be after the last displayed frame.

        It can be read until the maker is closed.
        """
        if self._last is not None:
            for frame in range(self._frames[-1] + 1, end or 0):
                self._add(frame, *self._last)
        self._shown.close()
        self._true.close()
        return Film(self._shown, self._true, self._fps, tuple(self._frames))

    def _add(self, frame: int, camera: Camera, picture: Picture) -> None:
        true, _ = self._truth(frame, camera)
        self._frames.append(frame)
        self._shown.add(picture)
        self._true.add(bytes_of(np.clip(true, 0.0, 1.0)))
