"""Options that supply what scene files do not record."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from cags_common.errors import ConfigError
from cags_common.geometry import Vec3
from cags_common.settings import check_settings, setting
from cags_encoder.formats.repair import REPAIRS, DropBroken
from cags_encoder.scenes.source import DEFAULT_FPS, MAX_FRAMES, Focus

_AXES: dict[str, Vec3] = {
    "+x": (1.0, 0.0, 0.0),
    "-x": (-1.0, 0.0, 0.0),
    "+y": (0.0, 1.0, 0.0),
    "-y": (0.0, -1.0, 0.0),
    "+z": (0.0, 0.0, 1.0),
    "-z": (0.0, 0.0, -1.0),
}
_AXES |= {name[1]: axis for name, axis in _AXES.items() if name[0] == "+"}
ROWS = ("auto", "keep", "mixed")


@dataclass(frozen=True)
class FileOptions:
    """Options of scenes that are read from files."""

    frames: int | None = setting(None, "number of frames; a shorter sequence repeats", low=1, high=MAX_FRAMES)
    fps: float = setting(DEFAULT_FPS, "frames per second", low=1.0, high=240.0)
    duration: float | None = setting(
        None, "length of a 4D file's clip in seconds; 50/30 if not given", low=0.01, high=3600.0
    )
    up: str | None = setting(None, "up direction; by default the usual one of the format", choices=tuple(_AXES))
    focus: str | None = setting(
        None, "X/Y/Z/RADIUS of the ball that viewers walk around; by default the bulk of the scene"
    )
    repair: str = setting(
        "none", "splats with NaN or infinities: none refuses the file, drop leaves them out", choices=REPAIRS
    )
    rows: str = setting(
        "auto", "whether a row is the same splat in all frames: keep, mixed, or auto to detect it", choices=ROWS
    )

    def __post_init__(self) -> None:
        check_settings(self)
        if self.focus is not None:
            _parse_focus(self.focus)

    def dropper(self) -> DropBroken | None:
        """A check that leaves out splats that cannot be drawn, if the options ask for it."""
        return DropBroken() if self.repair == "drop" else None

    def focus_or(self, otherwise: Callable[[], Focus]) -> Focus:
        """The focus given by the options, or the result of ``otherwise``."""
        return _parse_focus(self.focus) if self.focus is not None else otherwise()


def up_of(options: FileOptions, usual: Vec3) -> Vec3:
    """The up direction given by the options, or ``usual``."""
    return _AXES[options.up] if options.up else usual


def _parse_focus(text: str) -> Focus:
    try:
        x, y, z, radius = (float(part) for part in text.split("/"))
    except ValueError:
        raise ConfigError(f"focus = {text!r} must be X/Y/Z/RADIUS, four numbers in world units") from None
    if not all(map(math.isfinite, (x, y, z, radius))) or radius <= 0:
        raise ConfigError(f"focus = {text!r} must be finite, its radius positive")
    return Focus((x, y, z), radius)
