"""True pictures of a simulated session, rendered once for all users."""

from __future__ import annotations

from cags_client.output.truth import BundleTruth
from cags_client.settings import ClientSettings
from cags_common.bundle import BundleReader
from cags_common.geometry import F32, Camera


class LastTruth:
    """Renders true pictures and caches the newest one."""

    def __init__(self, reader: BundleReader, settings: ClientSettings) -> None:
        self._draw = BundleTruth(reader, settings)
        self._last: tuple[int, Camera, tuple[F32, F32]] | None = None

    def __call__(self, frame: int, camera: Camera) -> tuple[F32, F32]:
        """Picture [H, W, 3] and alpha [H, W] of ``frame`` from ``camera``. Callers must not modify them."""
        if self._last is None or self._last[:2] != (frame, camera):
            self._last = frame, camera, self._draw(frame, camera)
        return self._last[2]
