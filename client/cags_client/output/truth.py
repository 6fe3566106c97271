"""The true picture: a bundle's unquantised source frame, drawn at the client's pose."""

from __future__ import annotations

from cags_client.settings import ClientSettings
from cags_common import raster
from cags_common.bundle import BundleReader, Manifest
from cags_common.errors import ConfigError
from cags_common.geometry import F32, Camera
from cags_common.raster.base import Exactness, RasterScene, RenderOptions


class BundleTruth:
    """Draws source frames of a bundle. Raises :class:`BundleError` where there is none."""

    def __init__(self, bundle: str | BundleReader, settings: ClientSettings) -> None:
        """``bundle`` is its folder or URL, or a reader whose source frames are the truth."""
        self._url = bundle if isinstance(bundle, str) else "the bundle"
        self._reader = BundleReader.open(bundle) if isinstance(bundle, str) else bundle
        self._rasteriser = raster.create(settings.raster)
        self._options = RenderOptions(exactness=Exactness(settings.exactness), threads=settings.threads)
        self._scene: tuple[int, RasterScene] | None = None

    def check(self, info: Manifest) -> None:
        """Raise :class:`ConfigError` where this cannot be the scene that a server streams, by its ``info``."""
        frames = self._reader.manifest.frames
        if frames != info.frames:
            raise ConfigError(f"truth = {self._url!r} has {frames} frames and the stream {info.frames}: another scene")

    def __call__(self, frame: int, camera: Camera) -> tuple[F32, F32]:
        """Picture [H, W, 3] and alpha [H, W] of ``frame`` from ``camera``."""
        if self._scene is None or self._scene[0] != frame:
            self._scene = frame, self._rasteriser.load(self._reader.source(frame).splats)
        view = self._scene[1].render(camera, self._options)
        return view.rgb, view.alpha
