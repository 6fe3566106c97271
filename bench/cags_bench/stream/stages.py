"""Saves the stages of some frames, and their true pictures, as images."""

from __future__ import annotations

from pathlib import Path
from types import TracebackType

import numpy as np

from cags_bench.film.film import Truth
from cags_client.frame.presented import PresentedFrame
from cags_client.output.files import StagesSink, bytes_of, stage_path, write_png


class StageSaver:
    """Writes the stages of every n-th frame (:class:`StagesSink`) and its true picture to ``folder``.

    Pictures of an earlier play there are removed: the strip would show them beside those of this one.
    """

    def __init__(self, folder: Path, every: int, truth: Truth) -> None:
        self._folder, self._every = folder, every
        self._sink = StagesSink(folder, every)
        self._truth = truth

    def __enter__(self) -> StageSaver:
        for old in self._folder.glob("frame_*_*.png"):
            old.unlink(missing_ok=True)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._sink.close(completed=error is None)

    def save(self, presented: PresentedFrame) -> None:
        """Write the frame's pictures if its turn has come."""
        self._sink.show(presented, {})
        if presented.frame % self._every == 0:
            rgb, _ = self._truth(presented.frame, presented.camera)
            write_png(stage_path(self._folder, presented.frame, "truth"), bytes_of(np.clip(rgb, 0.0, 1.0)))
