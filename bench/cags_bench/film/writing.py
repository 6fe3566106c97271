"""Writes films as video clips and as strips of consecutive frames."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from cags_bench.film.film import Film, Picture
from cags_client.output.files import Mp4Writer, write_png
from cags_common.errors import ConfigError

STRIP_FRAMES = 12
STRIP_WIDTH_PX = 320
"""Width of one picture of a strip; smaller pictures are not enlarged."""

ERROR_GAIN = 4
"""Factor by which errors are amplified, around grey."""

TITLE_PX = 22


def write_clip(film: Film, path: Path, *, beside_truth: bool) -> None:
    """Write the film as H.264 to ``path``. ``beside_truth``: with the true picture to the right of each.

    Raises :class:`OutputError` if the file cannot be written.
    """
    writer = Mp4Writer(path, film.fps)
    done = False
    try:
        for number, (shown, true) in enumerate(film.pairs()):
            writer.add(number, np.concatenate([shown, true], axis=1) if beside_truth else shown)
        done = True
    finally:
        writer.close(completed=done)


def check_strip(frames: Sequence[int], start: int) -> None:
    """Raise :class:`ConfigError` unless a film of media ``frames`` has a strip that begins at ``start``."""
    if start in frames and frames.index(start) + STRIP_FRAMES <= len(frames):
        return
    last = frames[-1] - STRIP_FRAMES + 1 if frames else -1
    raise ConfigError(
        f"strip = {start}: {STRIP_FRAMES} frames from there are not in the film; "
        + (f"give {frames[0]} to {last}" if frames and last >= frames[0] else "play more frames")
    )


def write_strip(film: Film, start: int, psnr_db: Sequence[float | None], path: Path) -> None:
    """Write :data:`STRIP_FRAMES` frames from media frame ``start``, side by side: shown, true, and the error.

    ``psnr_db`` has a value for each frame of the film, None if it was not measured. Raises :class:`ConfigError` if the
    film ends too early.
    """
    check_strip(film.frames, start)
    first = film.frames.index(start)
    shown, true = film.shown.pictures(), film.truth.pictures()
    columns = []
    for at in range(first, first + STRIP_FRAMES):
        value = psnr_db[at]
        title = f"{film.frames[at]}" + ("" if value is None else f": {value:.1f} dB")
        pictures = [_small(p) for p in (shown[at], true[at], _error(shown[at], true[at]))]
        columns.append(np.concatenate([_bar(title, pictures[0].shape[1]), *pictures], axis=0))
    write_png(path, np.concatenate(columns, axis=1))


def _error(shown: Picture, true: Picture) -> Picture:
    error = (shown.astype(np.int16) - true.astype(np.int16)) * ERROR_GAIN + 128
    return np.asarray(error.clip(0, 255), np.uint8)


def _small(picture: Picture) -> Picture:
    height, width = picture.shape[:2]
    if width <= STRIP_WIDTH_PX:
        return picture
    size = STRIP_WIDTH_PX, max(round(height * STRIP_WIDTH_PX / width), 1)
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.uint8)


def _bar(title: str, width: int) -> Picture:
    bar = np.full((TITLE_PX, width, 3), 24, np.uint8)
    cv2.putText(bar, title, (4, 15), cv2.FONT_HERSHEY_SIMPLEX, 0.42, (235, 235, 235), 1, cv2.LINE_AA)
    return bar
