"""Scenes read from files: one file for a static scene, a folder of numbered files for a dynamic one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cags_common.bundle.reader import MANIFEST_NAME
from cags_common.errors import ConfigError, SceneError
from cags_common.geometry import Vec3
from cags_common.splats import Ids, Splats
from cags_encoder.formats import Format, read_splats
from cags_encoder.formats.registry import META
from cags_encoder.scenes.dynamic3d import Dynamic3dScene
from cags_encoder.scenes.file_options import FileOptions, up_of
from cags_encoder.scenes.folders import frame_of_folder, numbered_frames, warn_of_gap
from cags_encoder.scenes.source import Focus, FrameSource, focus_of
from cags_encoder.scenes.timed import TimedScene, is_timed

DEFAULT_STATIC_FRAMES = 60
"""Number of frames of a scene made of a single file."""

UNSORTED_FORMATS = ("ply",)
"""Formats whose writers keep the row order of training. Other writers sort every frame anew."""

SAME_SPLAT = 0.5
"""Share of rows that must look like the same splat in two frames if rows are to count as identities."""


class FileScene:
    """Frames from files, in order. A single file is a static scene: all frames share the same arrays."""

    def __init__(self, name: str, files: list[Path], options: FileOptions) -> None:
        self._name, self._files, self._options = name, files, options
        first, entry, kept = self._read_file(0)
        self._held: tuple[int, Splats, Ids] | None = (0, first, kept)
        self._degree = first.sh_degree
        self._focus = options.focus_or(lambda: focus_of(first))
        self._up = up_of(options, entry.up)
        self._rows_persist = len(files) == 1 or options.rows == "keep"
        if options.rows == "auto" and len(files) > 1 and entry.name in UNSORTED_FORMATS:
            self._rows_persist = all(rows_persist(first, self._read(k)[0]) for k in {1, len(files) - 1})

    @property
    def name(self) -> str:
        """Name of the file or folder."""
        return self._name

    @property
    def fps(self) -> float:
        """Frames per second, from the options."""
        return self._options.fps

    @property
    def up(self) -> Vec3:
        """The options' up direction, or the usual one of the format."""
        return self._up

    @property
    def focus(self) -> Focus:
        """The options' focus, or the bulk of the first frame."""
        return self._focus

    @property
    def still(self) -> bool:
        """Whether there is a single file (:func:`~cags_encoder.scenes.source.is_still`)."""
        return len(self._files) == 1

    def __len__(self) -> int:
        return self._options.frames or (len(self._files) if len(self._files) > 1 else DEFAULT_STATIC_FRAMES)

    def frame(self, index: int) -> Splats:
        """Frame ``index``; the sequence repeats if ``frames`` exceeds it."""
        if not 0 <= index < len(self):
            raise IndexError(index)
        return self._frame(index)[0]

    def ids(self, index: int) -> Ids | None:
        """Row numbers of static scenes, and of sequences that keep rows (new splats are appended); otherwise None."""
        return self._frame(index)[1] if self._rows_persist else None

    def _frame(self, index: int) -> tuple[Splats, Ids]:
        """Frame ``index``, and the rows of the file that it contains."""
        file, held = index % len(self._files), self._held
        if held is None or held[0] != file:
            self._held = held = (file, *self._read(file))
        return held[1], held[2]

    def _read(self, file: int) -> tuple[Splats, Ids]:
        splats, _, kept = self._read_file(file)
        if splats.sh_degree != self._degree:
            raise SceneError(
                f"{self._files[file]}: has SH degree {splats.sh_degree}, {self._files[0].name} has {self._degree}; "
                "all frames of a scene need the same"
            )
        return splats, kept

    def _read_file(self, file: int) -> tuple[Splats, Format, Ids]:
        drop = self._options.dropper()
        splats, entry = read_splats(self._files[file], drop or Splats.checked)
        return splats, entry, drop.kept if drop else np.arange(len(splats), dtype=np.int32)

    def __getstate__(self) -> dict[str, Any]:
        """Workers read the frames again."""
        return {**self.__dict__, "_held": None}


def exists(path: Path) -> bool:
    """Whether there is such a file or folder; no for names that are too long for the file system."""
    try:
        return path.exists()
    except OSError:
        return False


def open_files(path: Path, options: FileOptions) -> FrameSource:
    """Open a file or folder. Raises :class:`SceneError` for bad files, :class:`ConfigError` for bundles and options."""
    if not exists(path):
        raise SceneError(f"{path}: no such file or folder; give one, or 'procedural'")
    bundle = path.parent if path.name == MANIFEST_NAME else path
    if exists(bundle / MANIFEST_NAME):
        raise ConfigError(
            f"{path}: is a bundle, which is encoded already; cags-server --bundle {bundle} plays it, and "
            "cags-encode --inspect describes it"
        )
    if is_timed(path):
        return TimedScene(path, options)
    if options.duration is not None:
        raise ConfigError(f"{path}: duration = {options.duration} is for 4D files; give frames and fps")
    if path.suffix.lower() == ".npz":
        return Dynamic3dScene(path, options)
    name = (path.parent if path.name == META else path).resolve().name
    if path.is_file():
        return FileScene(name.split(".")[0], [path], options)
    single = frame_of_folder(path)
    if single:
        return FileScene(name, [single], options)
    frames = numbered_frames(path)
    warn_of_gap(path, frames)
    return FileScene(name, frames, options)


def rows_persist(before: Splats, after: Splats) -> bool:
    """Whether the common rows of two frames are the same splats.

    Methods that carry splats from frame to frame leave part of most splats unchanged: the position, or the opacity and
    the size or colour. They append new splats. Values that all splats share prove nothing, so rows must agree with
    themselves much more often than with other rows.
    """
    count = min(len(before), len(after))
    others = np.roll(np.arange(count), count // 2 + 1)
    own, foreign = _agreement(before, after, np.arange(count)), _agreement(before, after, others)
    return own - foreign >= SAME_SPLAT


def _agreement(before: Splats, after: Splats, rows: NDArray[np.intp]) -> float:
    """Share of ``rows`` of ``after`` that look like the first rows of ``before``."""
    means, sizes, colours, opacity = (
        np.all((getattr(before, name)[: len(rows)] == getattr(after, name)[rows]).reshape(len(rows), -1), axis=1)
        for name in ("means", "log_scales", "sh0", "logit_opacities")
    )
    return float(np.mean(means | (opacity & (sizes | colours))))
