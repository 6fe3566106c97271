"""Views of one scene as a client meets them: tiles at one LoD, and a coded reference from a pose that is off."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from cags_bench.bundles import cached_bundle
from cags_bench.references import REFERENCE_PX, coded_reference, moved
from cags_bench.restore.conditions import PREDICTED, Conditions
from cags_client.align import ReferencePicture
from cags_common import raster
from cags_common.bundle import BundleReader
from cags_common.bundle.player import BundlePlayer
from cags_common.errors import ConfigError
from cags_common.geometry import F32, F64, Camera, Intrinsics, Pose, angle_between
from cags_common.metrics import covered_mask
from cags_common.poses import Focus, PoseTrace, open_poses
from cags_common.raster.base import DepthKind, Footprint, RasterScene, RenderedView, RenderOptions
from cags_common.splats import Splats
from cags_encoder.settings import EncodeSettings
from cags_protocol.messages import PoseSample
from cags_server.fov import widened
from cags_server.predict import PoseHistory, create_predictor
from cags_server.settings import ServerSettings

FIRST_US = 1_700_000
"""The first view: a predictor has a history by then."""

VIEW_PERIOD_US = 1_700_000
"""Time between the moments of a walk that may be looked at; those that are lie over all of it."""

LEAST_COVERED, GLANCE_PX = 0.05, 64
"""Share of a glance's pixels that the scene must cover: people look away from it too, and then nothing is restored."""

HISTORY_US = 1_500_000
POSE_PERIOD_US = 1_000_000 // 60

HISTORY_PERIOD_US = 100_000
"""Time between references that the adapter has learnt from before."""


@dataclass(frozen=True, eq=False)
class Case:
    """One view at one LoD, pose error and kind of reference."""

    labels: dict[str, object]
    camera: Camera
    splats: Splats
    """What the client holds."""
    held: RasterScene
    """The same, loaded."""
    distorted: RenderedView
    truth: F32  # [H, W, 3] in [0, 1]
    truth_alpha: F32  # [H, W]
    reference: ReferencePicture
    plain: ReferencePicture
    """As the paper renders references."""
    own_options: RenderOptions
    """How the client draws its own splats from the reference's camera."""
    before: tuple[ReferencePicture, ...] = ()
    """References of the walk until then, the oldest first."""

    def own(self, depth: DepthKind = DepthKind.NONE) -> RenderedView:
        """The client's splats as the reference would show them, with their contributions: a reference's first view."""
        return self.held.render(self.reference.camera, replace(self.own_options, depth=depth, contribution=True))


class Cases:
    """All cases of one benchmark."""

    def __init__(self, conditions: Conditions) -> None:
        self._conditions = conditions
        bundle = cached_bundle(conditions.scene, conditions.cache, EncodeSettings(frames=1))
        with BundleReader.open(str(bundle)) as reader:
            self._manifest = m = reader.manifest
            rasteriser = raster.create("auto")
            self._truth = rasteriser.load(reader.source(0).splats)
            players = {share: BundlePlayer(reader, round(share * (m.lods - 1))) for share in conditions.lod_list}
            self._splats = {share: player.frame(0).splats for share, player in players.items()}
            self._held = {share: rasteriser.load(splats) for share, splats in self._splats.items()}
        self._walk = open_poses(conditions.poses, Focus(m.focus_centre, m.focus_radius, m.up))
        self._options = RenderOptions(threads=conditions.threads)
        self._moments = spread(self._looking(), conditions.views)

    def _looking(self) -> list[int]:
        """Moments of the walk in microseconds at which the scene is in view. Raises :class:`ConfigError`."""
        c, last = self._conditions, FIRST_US + (self._conditions.views - 1) * VIEW_PERIOD_US
        fov = math.radians(c.fov)
        glance = Intrinsics.of_fov(GLANCE_PX, GLANCE_PX, fov, fov)
        found = []
        for t_us in range(FIRST_US, max(last, self._walk.duration_us) + 1, VIEW_PERIOD_US):
            seen = self._truth.render(Camera(glance, self._walk.pose_at(t_us), self._manifest.near), self._options)
            if covered_mask(seen.alpha).mean() >= LEAST_COVERED:
                found.append(t_us)
        if not found:
            raise ConfigError(f"poses {c.poses}: never see {c.scene}; give another walk")
        return found

    def __len__(self) -> int:
        c = self._conditions
        return len(c.size_list) * len(c.lod_list) * len(c.error_list) * len(c.reference_list) * c.views

    def __iter__(self) -> Iterator[Case]:
        for size in self._conditions.size_list:
            for view, t_us in enumerate(self._moments):
                for error in self._conditions.error_list:
                    yield from self._of_view(size, view, t_us, error)

    def first(self, size: tuple[int, int], error: tuple[float, float]) -> Case:
        """The first view at the lowest LoD."""
        return next(self._of_view(size, 0, self._moments[0], error))

    def ladder(self, size: tuple[int, int], error: tuple[float, float]) -> Iterator[Case]:
        """The first view at every LoD, with the first kind of reference."""
        kind = self._conditions.reference_list[0]
        cases = self._of_view(size, 0, self._moments[0], error)
        return (case for case in cases if case.labels["reference"] == kind)

    def _of_view(self, size: tuple[int, int], view: int, t_us: int, error: tuple[float, float]) -> Iterator[Case]:
        focal = size[0] / (2 * math.tan(math.radians(self._conditions.fov) / 2))
        intrinsics = Intrinsics(*size, focal, focal, size[0] / 2, size[1] / 2)
        camera = Camera(intrinsics, self._walk.pose_at(t_us), self._manifest.near)
        there = Camera(self._reference_view(camera), self._pose(view, t_us, camera.pose, error), camera.near)
        seen = self._truth.render(camera, self._options)
        plain, _, _ = self._reference(camera, there, "plain")
        before = tuple(self._before(camera, view, t_us, error))
        for kind in self._conditions.reference_list:
            reference, options, size_bytes = self._reference(camera, there, kind)
            labels = {
                "size": f"{size[0]}x{size[1]}",
                "view": view,
                "error": "predicted" if error is PREDICTED else f"{error[0]:g}/{error[1]:g}",
                "error_deg": math.degrees(angle_between(camera.pose.rotation, there.pose.rotation)),
                "error_cm": 100 * math.dist(camera.pose.position, there.pose.position),
                "reference": kind,
                "reference_bytes": size_bytes,
                "covered": float(covered_mask(seen.alpha).mean()),
            }
            for share, splats in self._splats.items():
                yield Case(
                    labels={**labels, "lod_share": share},
                    camera=camera,
                    splats=splats,
                    held=self._held[share],
                    distorted=self._held[share].render(camera, self._options),
                    truth=np.clip(seen.rgb, 0.0, 1.0),
                    truth_alpha=seen.alpha,
                    reference=reference,
                    plain=plain,
                    own_options=options,
                    before=before,
                )

    def _before(self, camera: Camera, view: int, t_us: int, error: tuple[float, float]) -> Iterator[ReferencePicture]:
        """References of the last moments of the walk, each with an error of its own direction."""
        for ago in range(self._conditions.history, 0, -1):
            then_us = max(t_us - ago * HISTORY_PERIOD_US, 0)
            pose = self._pose(view, then_us, self._walk.pose_at(then_us), error, ago)
            yield self._reference(camera, Camera(self._reference_view(camera), pose, camera.near), "footprint")[0]

    def _reference_view(self, camera: Camera) -> Intrinsics:
        margin = self._conditions.margin
        return widened(camera.intrinsics, (margin, margin), *REFERENCE_PX)

    def _pose(self, view: int, t_us: int, pose: Pose, error: tuple[float, float], ago: int = 0) -> Pose:
        if error is PREDICTED:
            return predicted_pose(self._walk, t_us, self._manifest.fps)
        rng = np.random.default_rng((self._conditions.seed, view, ago) if ago else (self._conditions.seed, view))
        return moved(pose, math.radians(error[0]), error[1] / 100, _unit(rng), _unit(rng))

    def _reference(self, client: Camera, there: Camera, kind: str) -> tuple[ReferencePicture, RenderOptions, int]:
        """The decoded reference, how the client draws its own view of it, and the size of the access unit."""
        shipped = Footprint.of(client.intrinsics, there.intrinsics)
        options = RenderOptions(
            footprint=Footprint.classic() if kind == "plain" else shipped, threads=self._conditions.threads
        )
        rgb = supersampled(self._truth, client, there, kind, options)
        reference, size_bytes = coded_reference(rgb, there, fps=self._manifest.fps, crf=self._conditions.crf)
        return reference, options, size_bytes


def supersampled(scene: RasterScene, client: Camera, there: Camera, kind: str, options: RenderOptions) -> F32:
    """``scene`` from ``there`` [h, w, 3] in [0, 1]: drawn once or larger and averaged down, by ``kind``."""
    width, height = there.width_px, there.height_px
    factor = {"2x": 2.0, "full": client.intrinsics.fx_px / there.intrinsics.fx_px}.get(kind, 1.0)
    large = there.intrinsics.resized(max(width, round(width * factor)), max(height, round(height * factor)))
    footprint = options.footprint if large == there.intrinsics else Footprint.of(client.intrinsics, large)
    view = scene.render(replace(there, intrinsics=large), replace(options, footprint=footprint, depth=DepthKind.NONE))
    small = cv2.resize(view.rgb.clip(0, 1), (width, height), interpolation=cv2.INTER_AREA)
    return np.asarray(small, dtype=np.float32)


def spread(times_us: Sequence[int], views: int) -> list[int]:
    """``views`` of the times, evenly over all of them; from the first on again where there are fewer."""
    count = len(times_us)
    return [times_us[i * count // views if count >= views else i % count] for i in range(views)]


def predicted_pose(walk: PoseTrace, t_us: int, fps: float) -> Pose:
    """The viewer's pose at ``t_us`` as the server guesses it when it plans that frame, by its default predictor."""
    server = ServerSettings()
    newest = t_us - round(server.lead_frames * 1e6 / fps)
    times = list(range(max(newest - HISTORY_US, 0), newest + 1, POSE_PERIOD_US))
    history = PoseHistory([PoseSample(t, pose) for t, pose in zip(times, walk.poses_at(times), strict=True)])
    return create_predictor(server.predictor).predict(history, t_us - times[-1]).pose


def _unit(rng: np.random.Generator) -> F64:
    v: F64 = rng.normal(size=3)
    return v / max(float(np.linalg.norm(v)), 1e-9)
