"""Sinks that write files. Whatever is being written has a temporary name until it is whole."""

from __future__ import annotations

import os
import tempfile
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from types import TracebackType

import av
import cv2
import numpy as np
from av.video.frame import VideoFrame
from av.video.stream import VideoStream
from numpy.typing import NDArray

from cags_client.frame.presented import PresentedFrame
from cags_client.output.sinks import FrameSink, FrameStats
from cags_common.errors import ConfigError, OutputError
from cags_common.files import WholeFile, writable_folder, write_whole
from cags_common.geometry import F32

MP4_CRF = 16
"""x264's constant quality of a saved clip: visually lossless."""


def bytes_of(picture: F32) -> NDArray[np.uint8]:
    """[H, W, 3] uint8 RGB of a picture in [0, 1]; what lies above is white, and below it nothing may lie."""
    return np.asarray(cv2.convertScaleAbs(picture, alpha=255.0), dtype=np.uint8)


@dataclass(frozen=True, slots=True)
class Spooled:
    """Where a picture lies in a :class:`PictureSpool`, and its shape."""

    offset: int
    shape: tuple[int, ...]


class PictureSpool:
    """Pictures of bytes, put aside in a temporary file that nobody else sees and that goes with the spool."""

    def __init__(self) -> None:
        self._file = tempfile.TemporaryFile(prefix="cags-spool-", buffering=0)  # noqa: SIM115 - closed with the spool
        self._end = 0

    def put(self, picture: NDArray[np.uint8]) -> Spooled:
        """Keep a picture. Raises :class:`OutputError` where the disk is full."""
        spooled = Spooled(self._end, picture.shape)
        left = np.ascontiguousarray(picture).reshape(-1).data
        self._end += len(left)
        try:
            while left:
                left = left[self._file.write(left) :]
        except OSError as error:
            folder = tempfile.gettempdir()
            raise OutputError(f"{folder}: cannot keep pictures until the play ends ({error.strerror})") from error
        return spooled

    def take(self, spooled: Spooled) -> NDArray[np.uint8]:
        """A picture that was put here."""
        self._file.seek(spooled.offset)
        data = np.fromfile(self._file, np.uint8, int(np.prod(spooled.shape)))
        self._file.seek(self._end)
        return data.reshape(spooled.shape)

    def close(self) -> None:
        """Drop the pictures."""
        self._file.close()

    def __enter__(self) -> PictureSpool:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def write_png(path: Path, picture: NDArray[np.uint8]) -> None:
    """Write [H, W, 3] uint8 RGB; the file appears whole or not at all. Raises :class:`OutputError`."""
    _, data = cv2.imencode(".png", np.ascontiguousarray(picture[..., ::-1]), [cv2.IMWRITE_PNG_COMPRESSION, 1])
    write_whole(path, data.tobytes())


def open_save(spec: str, fps: float) -> FrameSink:
    """The sink of ``--record``: a folder of PNG files, or a clip where ``spec`` ends in ``.mp4``."""
    return Mp4Sink(Path(spec), fps) if _is_clip(Path(spec)) else PngSink(Path(spec))


def check_save(spec: str) -> None:
    """Raises :class:`ConfigError` where ``--record`` names neither a folder for pictures nor an ``.mp4`` file."""
    path = Path(spec)
    if not _is_clip(path) and path.suffix and not path.is_dir() and not spec.endswith(os.sep):
        raise ConfigError(
            f"--record {spec}: {path.suffix} is no format to record; end a video's name in .mp4 and a new folder's in /"
        )
    if _is_clip(path) and path.is_dir():
        raise ConfigError(f"--record {spec}: is a folder; give another name for the video")
    if not _is_clip(path):
        check_picture_folder("--record", path)


def check_picture_folder(flag: str, folder: Path) -> None:
    """Raises :class:`ConfigError` where ``folder`` is a file, or holds anything: a bundle, or another play."""
    if folder.exists() and not folder.is_dir():
        raise ConfigError(f"{flag} {folder}: is no folder; give the name of a new one")
    found = sorted(path.name for path in folder.iterdir()) if folder.is_dir() else []
    seen = [name for name in found if not name.startswith(".")]
    if seen:
        raise ConfigError(f"{flag} {folder}: the folder holds other files ({seen[0]}); give a new or an empty one")


def _is_clip(path: Path) -> bool:
    return path.suffix.lower() == ".mp4"


class PngSink:
    """``frame_00012.png`` a shown frame. Raises :class:`OutputError` where the folder cannot be written."""

    def __init__(self, folder: Path) -> None:
        self._folder = writable_folder(folder)

    def show(self, presented: PresentedFrame, stats: FrameStats) -> None:
        """See :class:`FrameSink`."""
        write_png(self._folder / f"frame_{presented.frame:05d}.png", bytes_of(presented.rgb))

    def close(self, *, completed: bool) -> None:
        """Every file is whole already."""


class StagesSink:
    """Intermediate pictures of every ``every``-th frame: ``frame_0030_restored.png`` and likewise reference, distorted,
    correction (what the reference changed) and, of a restorer of aligned pictures, aligned.

    They wait in a temporary file until the play has ended: coding four of them takes longer than a frame lasts.
    """

    def __init__(self, folder: Path, every: int) -> None:
        self._folder, self._every = writable_folder(folder), every
        self._spool = PictureSpool()
        self._waiting: list[tuple[Path, Spooled]] = []

    def show(self, presented: PresentedFrame, stats: FrameStats) -> None:
        """See :class:`FrameSink`."""
        if presented.frame % self._every:
            return
        pictures = {"distorted": presented.distorted, "restored": presented.rgb}
        if presented.reference is not None and presented.reference.coded is not None:
            pictures["reference"] = presented.reference.coded
        if presented.correction is not None:
            pictures["correction"] = presented.correction
        if presented.aligned_rgb is not None:
            pictures["aligned"] = presented.aligned_rgb
        for name, picture in pictures.items():
            path = stage_path(self._folder, presented.frame, name)
            self._waiting.append((path, self._spool.put(bytes_of(picture))))

    def close(self, *, completed: bool) -> None:
        """Write them, if ``completed``."""
        with self._spool:
            for path, spooled in self._waiting if completed else ():
                write_png(path, self._spool.take(spooled))


def stage_path(folder: Path, frame: int, name: str) -> Path:
    """Where one stage picture of a frame goes."""
    return folder / f"frame_{frame:04d}_{name}.png"


class Mp4Writer:
    """An H.264 clip of pictures at numbered places; a place that is left out holds the picture before it.

    Raises :class:`OutputError` where the file cannot be written.
    """

    def __init__(self, path: Path, fps: float) -> None:
        self._path, self._file = path, WholeFile(path)
        self._fps = Fraction(fps).limit_denominator(1001 * 60)
        self._stream: VideoStream | None = None
        try:
            self._container = av.open(str(self._file.writing), mode="w", format="mp4")
        except OSError as error:
            raise OutputError.of(path, error) from error

    def add(self, place: int, picture: NDArray[np.uint8]) -> None:
        """Append a picture [H, W, 3]; places rise, from 0. 4:2:0 needs even sizes: an odd row or column is cut off, and
        a single one is doubled.
        """
        height, width = picture.shape[:2]
        picture = picture[: height & ~1 or 1, : width & ~1 or 1]
        picture = picture.repeat(2 if height == 1 else 1, axis=0).repeat(2 if width == 1 else 1, axis=1)
        if self._stream is None:
            self._stream = self._open(picture.shape[1], picture.shape[0])
        frame = VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="rgb24")
        frame.pts, frame.time_base = place, 1 / self._fps
        try:
            self._container.mux(self._stream.encode(frame))
        except OSError as error:
            raise OutputError.of(self._path, error) from error

    def close(self, *, completed: bool) -> None:
        """Finish the file and give it its name, or remove it. Raises :class:`OutputError` where the disk is full."""
        try:
            if completed and self._stream is not None:
                self._container.mux(self._stream.encode(None))
            self._container.close()
            if completed and self._stream is not None:
                self._file.keep()
        except OSError as error:
            raise OutputError.of(self._path, error) from error
        finally:
            self._file.drop()

    def _open(self, width: int, height: int) -> VideoStream:
        stream = self._container.add_stream("libx264", rate=self._fps, options={"crf": str(MP4_CRF), "preset": "fast"})
        assert isinstance(stream, VideoStream)
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        return stream


class Mp4Sink:
    """An H.264 clip at the clip's frame rate; a frame that was not shown holds the one before."""

    def __init__(self, path: Path, fps: float) -> None:
        self._writer = Mp4Writer(path, fps)
        self._first: int | None = None

    def show(self, presented: PresentedFrame, stats: FrameStats) -> None:
        """See :class:`FrameSink`."""
        if self._first is None:
            self._first = presented.frame
        self._writer.add(presented.frame - self._first, bytes_of(presented.rgb))

    def close(self, *, completed: bool) -> None:
        """See :class:`FrameSink`."""
        self._writer.close(completed=completed)
