"""Scenes that are read from files: one file for a static scene, a folder of numbered files for a dynamic one."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cags_common.errors import ConfigError, SceneError
from cags_common.geometry import Vec3
from cags_common.settings import check_settings, setting
from cags_common.splats import Ids, Splats
from cags_encoder.formats import read_splats
from cags_encoder.formats.registry import META, SUFFIXES, is_scene_file
from cags_encoder.scenes.source import DEFAULT_FPS, MAX_FRAMES, Focus, focus_of

DEFAULT_STATIC_FRAMES = 60
"""Frames of a scene made of a single file."""

_AXES: dict[str, Vec3] = {
    "+x": (1.0, 0.0, 0.0),
    "-x": (-1.0, 0.0, 0.0),
    "+y": (0.0, 1.0, 0.0),
    "-y": (0.0, -1.0, 0.0),
    "+z": (0.0, 0.0, 1.0),
    "-z": (0.0, 0.0, -1.0),
}


@dataclass(frozen=True)
class FileOptions:
    """What files do not say about themselves."""

    frames: int | None = setting(
        None, "number of frames; longer than the sequence plays it again", low=1, high=MAX_FRAMES
    )
    fps: float = setting(DEFAULT_FPS, "frames a second", low=1.0, high=240.0)
    up: str | None = setting(None, "up direction; the format's usual one if not given", choices=tuple(_AXES))
    focus: str | None = setting(None, "X/Y/Z/RADIUS of what viewers walk around; the scene's bulk if not given")

    def __post_init__(self) -> None:
        check_settings(self)
        if self.focus is not None:
            parse_focus(self.focus)


def parse_focus(text: str) -> Focus:
    """``X/Y/Z/RADIUS`` in world units. Raises :class:`ConfigError`."""
    try:
        x, y, z, radius = (float(part) for part in text.split("/"))
    except ValueError:
        raise ConfigError(f"focus = {text!r} must be X/Y/Z/RADIUS, four numbers in world units") from None
    if not all(map(math.isfinite, (x, y, z, radius))) or radius <= 0:
        raise ConfigError(f"focus = {text!r} must be finite, its radius positive")
    return Focus((x, y, z), radius)


class FileScene:
    """Frames from files, in order. A single file is a static scene: every frame is the same arrays."""

    def __init__(self, name: str, files: list[Path], options: FileOptions) -> None:
        self._name, self._files, self._options = name, files, options
        self._held: tuple[int, Splats] | None = None
        first, entry = read_splats(files[0])
        self._degree = first.sh_degree
        self._focus = parse_focus(options.focus) if options.focus else focus_of(first)
        self._up = _AXES[options.up] if options.up else entry.up
        self._held = (0, first)

    @property
    def name(self) -> str:
        """Name of the file or folder."""
        return self._name

    @property
    def fps(self) -> float:
        """Frames a second, as the options say."""
        return self._options.fps

    @property
    def up(self) -> Vec3:
        """Up direction: the options', else the usual one of the format."""
        return self._up

    @property
    def focus(self) -> Focus:
        """The bulk of the first frame."""
        return self._focus

    def __len__(self) -> int:
        return self._options.frames or (len(self._files) if len(self._files) > 1 else DEFAULT_STATIC_FRAMES)

    def frame(self, index: int) -> Splats:
        """Frame ``index``; the sequence begins again where ``frames`` exceeds it."""
        if not 0 <= index < len(self):
            raise IndexError(index)
        file = index % len(self._files)
        if self._held is None or self._held[0] != file:
            splats, _ = read_splats(self._files[file])
            if splats.sh_degree != self._degree:
                raise SceneError(
                    f"{self._files[file]}: has SH degree {splats.sh_degree}, {self._files[0].name} has {self._degree}; "
                    "all frames of a scene need the same"
                )
            self._held = (file, splats)
        return self._held[1]

    def ids(self, index: int) -> Ids | None:
        """Rows of a static scene; None for sequences: sorted formats mix the rows anew in every frame."""
        if not 0 <= index < len(self):
            raise IndexError(index)
        return np.arange(len(self.frame(index)), dtype=np.int32) if len(self._files) == 1 else None

    def __getstate__(self) -> dict[str, Any]:
        """Workers read the frames themselves."""
        return {**self.__dict__, "_held": None}


def open_files(path: Path, options: FileOptions) -> FileScene:
    """Open a file or a folder. Raises :class:`SceneError` naming what is wrong."""
    if not path.exists():
        raise SceneError(f"{path}: no such file or folder; give one, or 'procedural'")
    name = (path.parent if path.name == META else path).resolve().name
    if path.is_file() or (path / META).is_file():
        return FileScene(name.split(".")[0], [path], options)
    return FileScene(name, numbered_files(path), options)


def numbered_files(folder: Path) -> list[Path]:
    """The frames in ``folder`` in natural order (2 before 10). Raises :class:`SceneError` unless there is one kind."""
    try:
        entries = [entry for entry in folder.iterdir() if not entry.name.startswith(".")]
    except OSError as error:
        raise SceneError(f"{folder}: cannot be listed ({error.strerror})") from error
    files = sorted((entry for entry in entries if is_scene_file(entry)), key=lambda entry: natural_key(entry.name))
    if not files:
        raise SceneError(f"{folder}: holds no frames; known are {', '.join(SUFFIXES)} and folders with {META}")
    kinds = sorted({entry.suffix.lower() for entry in files if entry.is_file()} | {META for e in files if e.is_dir()})
    if len(kinds) > 1:
        raise SceneError(f"{folder}: mixes {kinds[0]} and {kinds[1]}; keep one sequence of one format in a folder")
    unnumbered = [entry.name for entry in files if not any(c.isdigit() for c in entry.name.split(".")[0])]
    if unnumbered and len(files) > 1:
        raise SceneError(f"{folder}: {unnumbered[0]} has no frame number; name one file, or number the sequence")
    if len(files) > MAX_FRAMES:
        raise SceneError(f"{folder}: holds {len(files)} files; at most {MAX_FRAMES} frames are read")
    return files


def natural_key(name: str) -> tuple[tuple[int, int, str], ...]:
    """Sort key by which numbers inside names count as numbers."""
    parts = re.findall(r"[0-9]+|[^0-9]+", name)
    return tuple((0, int(part[-18:]), part) if part[0] in "0123456789" else (1, 0, part) for part in parts)
