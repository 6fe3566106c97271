"""One training pair: the stream's own steps, from the drawn view to the aligned reference."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cags_client import align
from cags_client.adapt import SirtAdapter
from cags_client.align import Aligned, ReferencePicture
from cags_client.restore import RestoreInput
from cags_common import raster
from cags_common.geometry import F32, Camera, angle_between
from cags_common.poses import PoseTrace
from cags_common.raster.base import DepthKind, Footprint, RasterScene, RenderedView, RenderOptions
from cags_common.video.colour import Chroma
from cags_common.video.h264 import H264Decoder, H264Encoder
from cags_common.video.noise import coding_noise
from cags_training.pairs.ladder import Ladder, draw_lods
from cags_training.pairs.settings import PairSettings
from cags_training.pairs.views import View, draw_view, nudged


@dataclass(frozen=True, eq=False)
class Pair:
    """What a restorer sees of a frame, and the true picture."""

    inputs: RestoreInput
    truth: F32  # [H, W, 3] in [0, 1]
    truth_alpha: F32  # [H, W]
    lod_share: float  # mean LoD of the tiles over the highest, 0 to 1
    angle_rad: float  # by which the reference's pose is off
    distance: float  # likewise, world units


class PairMaker:
    """Draws pairs from one scene."""

    def __init__(self, ladder: Ladder, walks: list[PoseTrace], settings: PairSettings, *, threads: int = 1) -> None:
        self.ladder = ladder
        self._walks, self._settings, self._threads = walks, settings, threads
        self._rasteriser = raster.create("auto")
        self._truth = self._rasteriser.load(ladder.truth)
        self._aligner = align.create("auto")

    def draw(self, rng: np.random.Generator) -> Pair:
        """A pair of a drawn view, LoD and reference quality."""
        s, manifest = self._settings, self.ladder.manifest
        view = draw_view(rng, manifest, self._walks, s)
        lods = draw_lods(rng, self.ladder.tiles, self.ladder.top, s.top_share)
        crf = rng.uniform(s.crf_low, s.crf_high)
        plain = rng.random() < s.plain_share
        adapted = rng.random() < s.adapted_share
        steps = int(rng.integers(1, s.adapted_steps + 1)) if adapted else 0
        before = [nudged(rng, view.reference, manifest) for _ in range(steps)]
        return self.make(view, lods, crf=float(crf), plain=bool(plain), before=before)

    def make(
        self, view: View, lods: np.ndarray, *, crf: float, plain: bool = False, before: Sequence[Camera] = ()
    ) -> Pair:
        """The pair of ``view`` with tiles at ``lods`` and a reference coded at ``crf``.

        The client has adapted its splats to the references seen from ``before``, which come first in the same video.
        """
        truth = self._render(self._truth, view.client)
        splats = self.ladder.at(lods)
        held = self._rasteriser.load(splats)
        video = _Video(view.reference, self.ladder.manifest.fps, crf)
        adapter = SirtAdapter(len(splats))
        options = replace(self._reference_options(view, plain=False), contribution=True)
        for camera in before:
            seen = self._reference(video, camera, view, plain)
            adapter.adapt(held, splats, seen, held.render(camera, options), options)
        distorted = self._render(held, view.client)
        reference = self._reference(video, view.reference, view, plain)
        own = held.render(view.reference, self._reference_options(view, plain=False))
        assert distorted.depth is not None
        aligned: Aligned = self._aligner.align(reference, distorted.depth, view.client)
        moved = np.subtract(view.client.pose.position, view.reference.pose.position)
        return Pair(
            inputs=RestoreInput(np.clip(distorted.rgb, 0, 1), distorted.alpha, aligned, reference, own),
            truth=np.clip(truth.rgb, 0, 1),
            truth_alpha=truth.alpha,
            lod_share=float(np.mean(lods)) / max(self.ladder.top, 1),
            angle_rad=angle_between(view.client.pose.rotation, view.reference.pose.rotation),
            distance=float(np.linalg.norm(moved)),
        )

    def _render(self, scene: RasterScene, camera: Camera) -> RenderedView:
        return scene.render(camera, RenderOptions(threads=self._threads))

    def _reference_options(self, view: View, plain: bool) -> RenderOptions:
        footprint = Footprint.of(view.client.intrinsics, view.reference.intrinsics)
        return RenderOptions(footprint=Footprint() if plain else footprint, depth=DepthKind.NONE, threads=self._threads)

    def _reference(self, video: _Video, camera: Camera, view: View, plain: bool) -> ReferencePicture:
        rgb = np.clip(self._truth.render(camera, self._reference_options(view, plain)).rgb, 0, 1)
        decoded = video.coded(rgb)
        return ReferencePicture(decoded, camera, 0, noise=coding_noise(rgb, decoded))


class _Video:
    """The reference stream: pictures as they come out of H.264."""

    def __init__(self, camera: Camera, fps: float, crf: float) -> None:
        self._encoder = H264Encoder(camera.width_px, camera.height_px, fps, crf=crf, chroma=Chroma.FULL)
        self._decoder = H264Decoder()
        self._idr = True

    def coded(self, rgb: F32) -> F32:
        """The next picture of the video, decoded."""
        decoded = self._decoder.decode(self._encoder.encode(rgb, idr=self._idr))
        assert decoded is not None, "the first picture of a video is an IDR picture"
        self._idr = False
        return decoded
