"""Views of one scene as a client meets them: tiles at one LoD, and a coded reference from a pose that is off."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from cags_bench.bundles import cached_bundle
from cags_bench.references import REFERENCE_PX, coded_reference, moved
from cags_bench.restore.command import RestoreBenchSettings
from cags_client.align import ReferencePicture
from cags_common import raster
from cags_common.bundle import BundleReader
from cags_common.bundle.player import BundlePlayer
from cags_common.geometry import F32, F64, Camera, Intrinsics
from cags_common.poses import Focus, open_poses
from cags_common.raster.base import DepthKind, Footprint, RasterScene, RenderedView, RenderOptions
from cags_encoder.settings import EncodeSettings
from cags_server.fov import widened

VIEW_PERIOD_US = 1_700_000


@dataclass(frozen=True, eq=False)
class Case:
    """One view at one LoD and pose error."""

    labels: dict[str, object]
    camera: Camera
    held: RasterScene  # the client's splats
    distorted: RenderedView
    truth: F32  # [H, W, 3] in [0, 1]
    truth_alpha: F32  # [H, W]
    reference: ReferencePicture  # through the client's footprint
    plain: ReferencePicture  # as the paper renders references
    options: RenderOptions

    def own(self) -> RenderedView:
        """The client's splats as the reference would show them."""
        footprint = Footprint.of(self.camera.intrinsics, self.reference.camera.intrinsics)
        options = RenderOptions(footprint=footprint, depth=DepthKind.NONE, threads=self.options.threads)
        return self.held.render(self.reference.camera, options)


class Cases:
    """All cases of one benchmark."""

    def __init__(self, settings: RestoreBenchSettings) -> None:
        self._settings = settings
        bundle = cached_bundle(settings.scene, settings.cache, EncodeSettings(frames=1))
        with BundleReader.open(str(bundle)) as reader:
            self._manifest = reader.manifest
            rasteriser = raster.create("auto")
            self._truth = rasteriser.load(reader.source(0).splats)
            self._held = {
                share: rasteriser.load(BundlePlayer(reader, round(share * (reader.manifest.lods - 1))).frame(0).splats)
                for share in settings.lod_list
            }
        m = self._manifest
        self._walk = open_poses("synthetic:walking:seed=1", Focus(m.focus_centre, m.focus_radius, m.up))
        self._options = RenderOptions(threads=settings.threads)

    def __len__(self) -> int:
        s = self._settings
        return len(s.size_list) * len(s.lod_list) * len(s.error_list) * s.views

    def __iter__(self) -> Iterator[Case]:
        for width, height in self._settings.size_list:
            focal = width / (2 * math.tan(math.radians(self._settings.fov) / 2))
            intrinsics = Intrinsics(width, height, focal, focal, width / 2, height / 2)
            for view in range(self._settings.views):
                camera = Camera(intrinsics, self._walk.pose_at((view + 1) * VIEW_PERIOD_US), self._manifest.near)
                yield from self._of_view(view, camera)

    def _of_view(self, view: int, camera: Camera) -> Iterator[Case]:
        truth = self._truth.render(camera, self._options)
        references = [self._references(camera, view, error) for error in self._settings.error_list]
        for share, held in self._held.items():
            distorted = held.render(camera, self._options)
            for (degrees, centimetres), (reference, plain) in zip(self._settings.error_list, references, strict=True):
                labels = {
                    "size": f"{camera.width_px}x{camera.height_px}",
                    "view": view,
                    "lod_share": share,
                    "error_deg": degrees,
                    "error_cm": centimetres,
                }
                shown = np.clip(truth.rgb, 0.0, 1.0)
                yield Case(labels, camera, held, distorted, shown, truth.alpha, reference, plain, self._options)

    def _references(
        self, camera: Camera, view: int, error: tuple[float, float]
    ) -> tuple[ReferencePicture, ReferencePicture]:
        s = self._settings
        rng = np.random.default_rng((s.seed, view))
        pose = moved(camera.pose, math.radians(error[0]), error[1] / 100, _unit(rng), _unit(rng))
        seen = Camera(widened(camera.intrinsics, (s.margin, s.margin), *REFERENCE_PX), pose, camera.near)
        footprint = Footprint.of(camera.intrinsics, seen.intrinsics)
        return self._coded(seen, footprint), self._coded(seen, Footprint.classic())

    def _coded(self, camera: Camera, footprint: Footprint) -> ReferencePicture:
        options = RenderOptions(footprint=footprint, depth=DepthKind.NONE, threads=self._settings.threads)
        return coded_reference(self._truth, camera, options, fps=self._manifest.fps, crf=self._settings.crf)


def _unit(rng: np.random.Generator) -> F64:
    v: F64 = rng.normal(size=3)
    return v / max(float(np.linalg.norm(v)), 1e-9)
