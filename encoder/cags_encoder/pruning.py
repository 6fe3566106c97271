"""Removal of splats that hardly contribute to pictures (after Reduced-3DGS, Papantonakis et al. 2024).

A splat's contribution is its compositing weight, summed over the pixels of views from likely viewpoints. If splats have
identities, the largest contribution among a few sampled frames decides for the whole clip, and splats in none of these
frames stay. Other sequences are pruned frame by frame.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from cags_common.bundle.manifest import Pruning
from cags_common.geometry import F32, Vec3
from cags_common.metrics import covered_mask, ssim_map
from cags_common.raster import DepthKind, RenderOptions, create
from cags_common.splats import Ids, Splats
from cags_encoder.scenes import Focus, FrameSource, is_still
from cags_encoder.views import cameras_around, contributions

SAMPLED_VIEWS = 24
SAMPLED_FRAMES = 8
"""Number of sampled frames in clips with identities."""

JUDGED_VIEWS = 8
"""Number of views for measuring the loss, between those that contributions were sampled from."""

MOST = 0.99
"""Largest share that may be removed."""

_STEPS = 7
"""Number of bisections for a PSNR, which find the share to 0.8 % of the splats."""

_FRAMES_HELD = 3
"""Number of frames without identities whose order is cached: those for measuring the loss."""

OnStep: TypeAlias = Callable[[int, int], None]
"""Called with completed steps and total steps."""


class Ranking:
    """The splats of a scene's frames, ordered by ascending contribution."""

    def __init__(self, source: FrameSource, frames: int) -> None:
        """Samples :data:`SAMPLED_FRAMES` of ``frames`` if splats have identities. Raises :class:`SceneError`."""
        self._source = source
        self._clip = _clip_order(source, frames) if source.ids(0) is not None else None
        self._frames: OrderedDict[int, NDArray[np.intp]] = OrderedDict()

    def kept(self, index: int, share: float) -> NDArray[np.intp]:
        """Rows of frame ``index`` that stay when a ``share`` is removed, ascending; at least one stays."""
        if self._clip is None:
            order = self._order(index)
            return np.sort(order[int(share * len(order)) :])
        known = self._source.ids(index)
        assert known is not None  # sources know identities of all frames or of none
        rows = np.flatnonzero(~np.isin(known, self._clip[: int(share * len(self._clip))]))
        return rows if len(rows) else np.arange(1)

    def _order(self, index: int) -> NDArray[np.intp]:
        if index not in self._frames:
            weights = _weights(self._source, self._source.frame(index))
            self._frames[index] = np.argsort(weights, kind="stable")
            if len(self._frames) > _FRAMES_HELD:
                self._frames.popitem(last=False)
        return self._frames[index]


@dataclass(eq=False)
class _Kept:
    """What stays of a frame; of a still scene also the arrays, which all of its frames share."""

    frame: int
    rows: NDArray[np.intp]
    splats: Splats | None = None
    ids: Ids | None = None


class PrunedSource:
    """A :class:`FrameSource` of a scene without the ``share`` of its splats that contributes least.

    Raises :class:`SceneError` for frames that cannot be read.
    """

    def __init__(self, source: FrameSource, ranking: Ranking, share: float) -> None:
        self._source, self._ranking, self.share = source, ranking, share
        self.still = is_still(source)
        self._held: _Kept | None = None

    @property
    def name(self) -> str:
        """Name of the scene."""
        return self._source.name

    @property
    def fps(self) -> float:
        """Frame rate of the scene."""
        return self._source.fps

    @property
    def up(self) -> Vec3:
        """Up direction of the scene."""
        return self._source.up

    @property
    def focus(self) -> Focus:
        """Focus of the scene."""
        return self._source.focus

    def __len__(self) -> int:
        return len(self._source)

    def frame(self, index: int) -> Splats:
        """Frame ``index`` without the pruned splats."""
        kept = self._kept(index)
        if not self.still:
            return self._source.frame(index).take(kept.rows)
        if kept.splats is None:
            kept.splats = self._source.frame(index).take(kept.rows)
        return kept.splats

    def ids(self, index: int) -> Ids | None:
        """The scene's identities of the remaining splats."""
        kept = self._kept(index)
        if not self.still or kept.ids is None:
            known = self._source.ids(index)
            kept.ids = None if known is None else known[kept.rows]
        return kept.ids

    def _kept(self, index: int) -> _Kept:
        if self._held is None or not (self.still or self._held.frame == index):
            self._held = _Kept(index, self._ranking.kept(index, self.share))
        return self._held


class PruningJudge:
    """Measures the loss by pruning: PSNR and SSIM against the whole scene, both unquantised.

    Judged are the covered pixels of :data:`JUDGED_VIEWS` views of the first, middle and last frame.
    """

    def __init__(self, source: FrameSource, frames: int) -> None:
        self._cameras = cameras_around(source.focus, source.up, JUDGED_VIEWS, phase=0.8)
        self._rasteriser, judged = create("auto"), sorted({0, frames // 2, frames - 1})
        whole = {index: source.frame(index) for index in judged}
        self._before = sum(map(len, whole.values())) // len(whole)
        self._true = {index: self._pictures(splats) for index, splats in whole.items()}

    def __call__(self, pruned: PrunedSource) -> Pruning:
        """The loss of the scene ``pruned``."""
        error, likeness, pixels, after = 1e-12, 0.0, 1e-9, 0
        for index, pictures in self._true.items():
            left = pruned.frame(index)
            after += len(left)
            for true, shown in zip(pictures, self._pictures(left), strict=True):
                mask = covered_mask(np.maximum(true[1], shown[1]))
                error += float(np.square(true[0] - shown[0])[mask].mean(axis=1).sum())
                likeness += float(ssim_map(shown[0], true[0])[mask].mean(axis=1).sum())
                pixels += int(mask.sum())
        psnr_db = min(-10 * math.log10(error / pixels), 100.0) if pixels >= 1 else 100.0
        similar = likeness / pixels if pixels >= 1 else 1.0
        return Pruning(pruned.share, self._before, after // len(self._true), round(psnr_db, 3), round(similar, 5))

    def _pictures(self, splats: Splats) -> list[tuple[F32, F32]]:
        """Colours [H, W, 3] and alpha [H, W] of each view."""
        scene, options = self._rasteriser.load(splats), RenderOptions(depth=DepthKind.NONE)
        views = [scene.render(camera, options) for camera in self._cameras]
        return [(np.clip(view.rgb, 0, 1), view.alpha) for view in views]


def prune(source: FrameSource, share: float, frames: int, on_step: OnStep) -> tuple[PrunedSource, Pruning]:
    """The scene without a ``share`` of its splats, and its loss."""
    pruned = PrunedSource(source, Ranking(source, frames), share)
    on_step(1, 2)
    cost = PruningJudge(source, frames)(pruned)
    on_step(2, 2)
    return pruned, cost


def prune_within(source: FrameSource, psnr_db: float, frames: int, on_step: OnStep) -> tuple[PrunedSource, Pruning]:
    """The scene with as few splats as ``psnr_db`` permits, and its loss."""
    ranking, judge = Ranking(source, frames), PruningJudge(source, frames)
    best = PrunedSource(source, ranking, 0.0)
    cost, too_many = judge(best), MOST
    for step in range(_STEPS):
        on_step(step, _STEPS)
        tried = PrunedSource(source, ranking, (best.share + too_many) / 2)
        found = judge(tried)
        if found.psnr_db >= psnr_db:
            best, cost = tried, found
        else:
            too_many = tried.share
    on_step(_STEPS, _STEPS)
    return best, cost


def _clip_order(source: FrameSource, frames: int) -> Ids:
    """A clip's identities by their largest contribution in any sampled frame, ascending."""
    best: NDArray[np.float64] = np.full(0, -1.0)
    sampled = np.unique(np.linspace(0, frames - 1, min(SAMPLED_FRAMES, frames)).astype(int))
    for index in sampled:
        ids = source.ids(int(index))
        assert ids is not None
        more = int(ids.max()) + 1 - len(best)
        best = np.concatenate([best, np.full(max(more, 0), -1.0)])
        np.maximum.at(best, ids, _weights(source, source.frame(int(index))))
    seen = np.flatnonzero(best >= 0)
    return seen[np.argsort(best[seen], kind="stable")].astype(np.int32)


def _weights(source: FrameSource, splats: Splats) -> NDArray[np.float64]:
    return contributions(splats, cameras_around(source.focus, source.up, SAMPLED_VIEWS), create("auto"))
