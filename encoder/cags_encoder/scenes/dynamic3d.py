"""Dynamic 3D Gaussians' ``params.npz`` (Luiten et al. 2023): one set of splats that move, rotate and change colour.

Positions ``means3D`` [T, N, 3], colours ``rgb_colors`` [T, N, 3] in 0..1 and rotations ``unnorm_rotations`` [T, N, 4]
(wxyz) are stored per time step; ``log_scales`` [N, 3] and ``logit_opacities`` [N, 1] once. Each array may have a time
axis or not. Row numbers are identities.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cags_common.errors import SceneError
from cags_common.geometry import F32, Vec3
from cags_common.splats import MAX_SPLATS, SH_C0, Ids, Splats
from cags_encoder.formats.files import quietly
from cags_encoder.formats.npz_arrays import NpzArrays
from cags_encoder.scenes.file_options import FileOptions, up_of
from cags_encoder.scenes.source import MAX_FRAMES, Focus, focus_of

_WIDTHS = {"means3D": 3, "rgb_colors": 3, "unnorm_rotations": 4, "log_scales": 3, "logit_opacities": 1}
_UP: Vec3 = (0.0, -1.0, 0.0)


class Dynamic3dScene:
    """The time steps of a ``params.npz``. Raises :class:`SceneError` for other archives."""

    def __init__(self, path: Path, options: FileOptions) -> None:
        self._path, self._options = path, options
        self._drop = options.dropper()
        self._open()
        steps = {len(a) for a in self._arrays.values()} - {1}
        counts = {a.shape[1] for a in self._arrays.values()}
        if len(steps) > 1 or len(counts) != 1:
            raise SceneError(f"{path}: its arrays disagree about the number of steps or splats; repair the file")
        self._steps, self._count = max(steps, default=1), counts.pop()
        if not 1 <= self._count <= MAX_SPLATS or not 1 <= self._steps <= MAX_FRAMES:
            raise SceneError(
                f"{path}: holds {self._steps} steps of {self._count} splats; give a file with at least one"
            )
        self._focus = options.focus_or(lambda: focus_of(self.frame(0)))

    def _open(self) -> None:
        archive = NpzArrays(self._path)
        self._arrays = {name: self._timed(archive.array(name, width), name, width) for name, width in _WIDTHS.items()}

    def _timed(self, array: NDArray[np.floating[Any]], name: str, width: int) -> NDArray[np.floating[Any]]:
        """``array`` as [T or 1, N, width]."""
        timed = array[None] if array.ndim == 2 else array
        if timed.ndim != 3 or timed.shape[2] != width:
            raise SceneError(f"{self._path}: {name} has shape {array.shape}, expected [T, N, {width}] or [N, {width}]")
        return timed

    @property
    def name(self) -> str:
        """Name of the folder that holds the file."""
        return self._path.resolve().parent.name

    @property
    def fps(self) -> float:
        """Frame rate given by the options."""
        return self._options.fps

    @property
    def up(self) -> Vec3:
        """The options' up direction, or -Y: the method's scenes use OpenCV's axes."""
        return up_of(self._options, _UP)

    @property
    def focus(self) -> Focus:
        """The options' focus, or the bulk of the first step."""
        return self._focus

    def __len__(self) -> int:
        return self._options.frames or self._steps

    @quietly
    def frame(self, index: int) -> Splats:
        """Time step ``index``; the sequence repeats if ``frames`` exceeds it."""
        if not 0 <= index < len(self):
            raise IndexError(index)
        step = index % self._steps
        rgb = self._row("rgb_colors", step)
        splats = Splats(
            means=self._row("means3D", step),
            quats=self._row("unnorm_rotations", step),
            log_scales=self._row("log_scales", step),
            logit_opacities=self._row("logit_opacities", step)[:, 0],
            sh0=(rgb - np.float32(0.5)) / np.float32(SH_C0),
            sh_rest=np.zeros((self._count, 0, 3), np.float32),
        )
        return (self._drop or Splats.checked)(splats, f"{self._path}: step {step}")

    def _row(self, name: str, step: int) -> F32:
        array = self._arrays[name]
        return np.asarray(array[min(step, len(array) - 1)]).astype(np.float32)

    def ids(self, index: int) -> Ids:
        """Row numbers."""
        if not 0 <= index < len(self):
            raise IndexError(index)
        if self._drop is None:
            return np.arange(self._count, dtype=np.int32)
        self.frame(index)
        return self._drop.kept

    def __getstate__(self) -> dict[str, Any]:
        """Workers map the file again."""
        return {name: value for name, value in self.__dict__.items() if name != "_arrays"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._open()
