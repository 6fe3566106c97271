"""One training pair: the stream's own steps, from the drawn view to the aligned reference."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cags_client.frame import align
from cags_client.frame.align import ReferencePicture
from cags_client.frame.restore import RestoreInput, expected_psnr_db
from cags_common import raster
from cags_common.geometry import F32, Camera
from cags_common.poses import PoseTrace
from cags_common.raster.base import DepthKind, Footprint, RasterScene, RenderedView, RenderOptions
from cags_common.video.colour import Chroma
from cags_common.video.h264 import H264Decoder, H264Encoder
from cags_research.training.pairs.ladder import Ladder, draw_lods
from cags_research.training.pairs.settings import PairSettings
from cags_research.training.pairs.views import View, draw_view, nudged


@dataclass(frozen=True, eq=False)
class Pair:
    """What a restorer sees of a frame, and the true picture."""

    inputs: RestoreInput
    truth: F32  # [H, W, 3] in [0, 1]
    truth_alpha: F32  # [H, W]
    ladder: float  # mean LoD of the tiles, as a share of the ladder


@dataclass(frozen=True)
class Tint:
    """Other colours for a whole scene: channels exchanged, then scaled. Rendering over black is linear in colour."""

    order: tuple[int, int, int] = (0, 1, 2)
    gains: tuple[float, float, float] = (1.0, 1.0, 1.0)

    def of(self, rgb: F32) -> F32:
        """``rgb`` [H, W, 3] in these colours, clipped to [0, 1]."""
        return np.clip(rgb[..., self.order] * np.asarray(self.gains, np.float32), 0.0, 1.0)

    @property
    def fainter_db(self) -> float:
        """By how much errors fall with the colours."""
        return -10 * math.log10(sum(gain * gain for gain in self.gains) / 3)

    @staticmethod
    def draw(rng: np.random.Generator) -> Tint:
        """Any order, each channel between a half and all of its brightness."""
        a, b, c = (int(i) for i in rng.permutation(3))
        gains = rng.uniform(GAIN_LOW, 1.0) * rng.uniform(GAIN_LOW, 1.0, 3)
        return Tint((a, b, c), (float(gains[0]), float(gains[1]), float(gains[2])))


GAIN_LOW = 0.7
"""Least brightness of tinted scenes, of all channels and of one against the others."""


class PairMaker:
    """Draws pairs from one scene."""

    def __init__(self, ladder: Ladder, walks: list[PoseTrace], settings: PairSettings, *, threads: int = 1) -> None:
        self.ladder = ladder
        self._walks, self._settings, self._threads = walks, settings, threads
        self._rasteriser = raster.create("auto")
        self._truth = self._rasteriser.load(ladder.truth)
        self._aligner = align.create("fast")

    def draw(self, rng: np.random.Generator) -> Pair:
        """A pair of a drawn view, LoD and reference quality."""
        s, manifest = self._settings, self.ladder.manifest
        view = draw_view(rng, manifest, self._walks, s)
        lods = draw_lods(rng, self.ladder.tiles, self.ladder.top, s.top_share)
        crf = rng.uniform(s.crf_low, s.crf_high)
        plain = rng.random() < s.plain_share
        before = [nudged(rng, view.reference, manifest) for _ in range(int(rng.integers(0, s.frames_before + 1)))]
        return self.make(view, lods, crf=float(crf), plain=bool(plain), before=before, tint=Tint.draw(rng))

    def draw_levels(self, rng: np.random.Generator, levels: Sequence[float]) -> list[Pair]:
        """A drawn view with all tiles at each of ``levels``, shares of the ladder; in the scene's own colours."""
        s, manifest = self._settings, self.ladder.manifest
        view = draw_view(rng, manifest, self._walks, s)
        crf = float(rng.uniform(s.crf_low, s.crf_high))
        before = [nudged(rng, view.reference, manifest) for _ in range(int(rng.integers(0, s.frames_before + 1)))]
        lods = [np.full(self.ladder.tiles, round(level * self.ladder.top)) for level in levels]
        return [self.make(view, held, crf=crf, before=before) for held in lods]

    def make(
        self,
        view: View,
        lods: np.ndarray,
        *,
        crf: float,
        plain: bool = False,
        before: Sequence[Camera] = (),
        tint: Tint | None = None,
    ) -> Pair:
        """The pair of ``view`` with tiles at ``lods`` and a reference coded at ``crf``, in the colours of ``tint``.

        References seen from ``before`` come first in the same video.
        """
        colours = tint or Tint()
        held = self._rasteriser.load(self.ladder.at(lods))
        scene = _Shown(self._truth, self._reference_options(view, plain=plain), colours)
        video = _Video(view.reference, self.ladder.manifest.fps, crf)
        for camera in before:
            video.reference(scene, camera)
        distorted, truth = self._render(held, view.client), self._render(self._truth, view.client)
        reference = video.reference(scene, view.reference)
        assert distorted.depth is not None
        aligned = self._aligner.align(reference, distorted.depth, view.client)
        measured_db = expected_psnr_db(self.ladder.lod_mean(lods, view.client), self.ladder.manifest)
        inputs = RestoreInput(colours.of(distorted.rgb), aligned, measured_db + colours.fainter_db)
        share = float(np.mean(lods)) / max(self.ladder.top, 1)
        return Pair(inputs, truth=colours.of(truth.rgb), truth_alpha=truth.alpha, ladder=share)

    def _render(self, scene: RasterScene, camera: Camera) -> RenderedView:
        return scene.render(camera, RenderOptions(threads=self._threads))

    def _reference_options(self, view: View, plain: bool) -> RenderOptions:
        footprint = Footprint.of(view.client.intrinsics, view.reference.intrinsics)
        return RenderOptions(footprint=Footprint() if plain else footprint, depth=DepthKind.NONE, threads=self._threads)


@dataclass(frozen=True, eq=False)
class _Shown:
    """What a server renders references of."""

    scene: RasterScene
    options: RenderOptions
    tint: Tint


class _Video:
    """The reference stream: pictures as they come out of H.264."""

    def __init__(self, camera: Camera, fps: float, crf: float) -> None:
        self._encoder = H264Encoder(camera.width_px, camera.height_px, fps, crf=crf, chroma=Chroma.FULL)
        self._decoder = H264Decoder()
        self._idr = True

    def reference(self, shown: _Shown, camera: Camera) -> ReferencePicture:
        """The next picture of the video, decoded."""
        rgb = shown.tint.of(shown.scene.render(camera, shown.options).rgb)
        decoded = self._decoder.decode(self._encoder.encode(rgb, idr=self._idr))
        assert decoded is not None, "the first picture of a video is an IDR picture"
        self._idr = False
        return ReferencePicture(decoded, camera, 0)
