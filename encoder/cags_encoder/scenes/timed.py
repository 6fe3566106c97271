"""Scenes from 4D files: frames sampled from splats with their own motion and lifetime."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cags_common.geometry import Vec3
from cags_common.splats import Ids, Splats
from cags_encoder.formats.files import read_file
from cags_encoder.formats.ply_container import MAX_HEADER_BYTES, parse_header
from cags_encoder.formats.registry import Y_DOWN
from cags_encoder.formats.spacetime_ply import is_spacetime_ply, parse_spacetime_ply
from cags_encoder.formats.splatv import SUFFIX, parse_splatv
from cags_encoder.scenes.file_options import FileOptions, up_of
from cags_encoder.scenes.source import Focus, focus_of

DEFAULT_DURATION_S = 50 / 30
"""Default length of a clip, which files do not record: the 50 frames that SpaceTime Gaussians trains a model on."""


def is_timed(path: Path) -> bool:
    """Whether a file holds splats over time. Damaged headers are left to the parsers of other formats."""
    if path.suffix.lower() == SUFFIX:
        return True
    if path.suffix.lower() != ".ply" or not path.is_file():
        return False
    try:
        with path.open("rb") as file:
            head = file.read(MAX_HEADER_BYTES)
    except OSError:
        return False  # the parser that reads it next will report why
    return b"trbf_center" in head and is_spacetime_ply(parse_header(head, str(path)))


class TimedScene:
    """A 4D file sampled at ``fps`` frames per second; its row numbers are identities. Raises :class:`SceneError`."""

    def __init__(self, path: Path, options: FileOptions) -> None:
        self._path, self._options = path, options
        self._duration_s = options.duration or DEFAULT_DURATION_S
        self._read()
        self._focus = options.focus_or(lambda: focus_of(self.frame(0)))

    def _read(self) -> None:
        data, drop = read_file(self._path), self._options.dropper()
        parse = parse_splatv if self._path.suffix.lower() == SUFFIX else parse_spacetime_ply
        self._timed = parse(data, str(self._path), drop)

    @property
    def name(self) -> str:
        """Name of the file."""
        return self._path.resolve().name.split(".")[0]

    @property
    def fps(self) -> float:
        """Frame rate given by the options."""
        return self._options.fps

    @property
    def up(self) -> Vec3:
        """The options' up direction, or -Y: these files come from COLMAP reconstructions."""
        return up_of(self._options, Y_DOWN)

    @property
    def focus(self) -> Focus:
        """The options' focus, or the bulk of the first frame."""
        return self._focus

    def __len__(self) -> int:
        return self._options.frames or max(1, round(self._duration_s * self._options.fps))

    def frame(self, index: int) -> Splats:
        """The visible splats at ``index / fps`` seconds; the clip repeats after its end."""
        return self._frame(index)[0]

    def ids(self, index: int) -> Ids:
        """Row numbers of the file."""
        rows = self._rows(index) if self._options.repair == "none" else self._frame(index)[1]
        return rows.astype(np.int32)

    def _frame(self, index: int) -> tuple[Splats, NDArray[np.intp]]:
        """Frame ``index`` and its rows [n] of the file. A splat that cannot be drawn now may be drawn in others."""
        rows, drop = self._rows(index), self._options.dropper()
        if drop is None:
            return self._timed.at(self._time(index), rows, f"{self._path}: frame {index}"), rows
        splats = self._timed.at(self._time(index), rows, str(self._path), drop)  # reported once, not in every frame
        return splats, rows[drop.kept]

    def _rows(self, index: int) -> NDArray[np.intp]:
        time = self._time(index)
        rows = self._timed.alive(time)
        return rows if len(rows) else self._timed.brightest(time)

    def _time(self, index: int) -> float:
        """Time of frame ``index`` as a share of the clip's length."""
        if not 0 <= index < len(self):
            raise IndexError(index)
        frames = max(1, round(self._duration_s * self._options.fps))
        return (index % frames) / (self._options.fps * self._duration_s)

    def __getstate__(self) -> dict[str, Any]:
        """Workers read the file again."""
        return {name: value for name, value in self.__dict__.items() if name != "_timed"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._read()
