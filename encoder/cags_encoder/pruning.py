"""Leaving out the splats that hardly contribute to pictures (after Reduced-3DGS, Papantonakis et al. 2024).

A splat's contribution is its compositing weight summed over the pixels of views from where viewers stand. Where splats
have identities over time, what a splat contributes at its best moment of those looked at decides, for the whole clip;
splats that none of those moments holds stay. Other sequences are pruned frame by frame.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from cags_common.bundle.manifest import Pruning
from cags_common.geometry import F32, Camera, Vec3
from cags_common.metrics import covered_mask, ssim_map
from cags_common.raster import DepthKind, Rasteriser, RenderOptions, create
from cags_common.splats import Ids, Splats
from cags_encoder.scenes import Focus, FrameSource
from cags_encoder.views import cameras_around, contributions

SAMPLED_VIEWS = 24
SAMPLED_FRAMES = 8
"""Moments at which the splats of clips with identities are looked at."""

JUDGED_VIEWS = 8
"""Views that the cost is measured on: between those that contributions were sampled from."""


class PrunedSource:
    """A scene without the ``share`` of its splats that contribute least; a :class:`FrameSource`.

    Raises :class:`SceneError` for frames that cannot be read.
    """

    def __init__(self, source: FrameSource, share: float, frames: int) -> None:
        self._source, self._share = source, share
        known = source.ids(0) is not None
        self._gone = _least(source, share, frames) if known else np.zeros(0, np.int32)
        self._held: tuple[int, NDArray[np.intp]] | None = None

    @property
    def name(self) -> str:
        """The scene's."""
        return self._source.name

    @property
    def fps(self) -> float:
        """The scene's."""
        return self._source.fps

    @property
    def up(self) -> Vec3:
        """The scene's."""
        return self._source.up

    @property
    def focus(self) -> Focus:
        """The scene's."""
        return self._source.focus

    def __len__(self) -> int:
        return len(self._source)

    def frame(self, index: int) -> Splats:
        """Frame ``index`` without what was pruned."""
        splats = self._source.frame(index)
        return splats.take(self._kept(index, splats))

    def ids(self, index: int) -> Ids | None:
        """The scene's identities of what is left."""
        known = self._source.ids(index)
        return None if known is None else known[self._kept(index, None)]

    def _kept(self, index: int, splats: Splats | None) -> NDArray[np.intp]:
        """Rows of frame ``index`` that stay; at least one does."""
        if self._held is None or self._held[0] != index:
            known = self._source.ids(index)
            if known is not None:
                rows = np.flatnonzero(~np.isin(known, self._gone))
                self._held = index, rows if len(rows) else np.arange(1)
            else:
                weights = _weights(self._source, splats if splats is not None else self._source.frame(index))
                self._held = index, np.sort(np.argsort(weights, kind="stable")[int(self._share * len(weights)) :])
        return self._held[1]


def pruning_cost(
    source: FrameSource, pruned: FrameSource, share: float, frames: int, tell: Callable[[int, int], None]
) -> Pruning:
    """What pruning costs in pictures: PSNR and SSIM of the pruned scene against the whole one, both unquantised.

    Over the covered pixels of :data:`JUDGED_VIEWS` views of the first, middle and last frame.
    """
    cameras = cameras_around(source.focus, source.up, JUDGED_VIEWS, phase=0.8)
    rasteriser, judged = create("auto"), sorted({0, frames // 2, frames - 1})
    error, likeness, pixels, before, after = 1e-12, 0.0, 1e-9, 0, 0
    for done, index in enumerate(judged):
        whole, left = source.frame(index), pruned.frame(index)
        before, after = before + len(whole), after + len(left)
        for true, shown in zip(
            _pictures(whole, cameras, rasteriser), _pictures(left, cameras, rasteriser), strict=True
        ):
            mask = covered_mask(np.maximum(true[1], shown[1]))
            error += float(np.square(true[0] - shown[0])[mask].mean(axis=1).sum())
            likeness += float(ssim_map(shown[0], true[0])[mask].mean(axis=1).sum())
            pixels += int(mask.sum())
        tell(done + 1, len(judged))
    psnr_db = min(-10 * math.log10(error / pixels), 100.0) if pixels >= 1 else 100.0
    similar = likeness / pixels if pixels >= 1 else 1.0
    return Pruning(share, before // len(judged), after // len(judged), round(psnr_db, 3), round(similar, 5))


def _least(source: FrameSource, share: float, frames: int) -> Ids:
    """The ``share`` of a clip's identities that contribute least at their best moment, ascending."""
    best: NDArray[np.float64] = np.full(0, -1.0)
    looks = np.unique(np.linspace(0, frames - 1, min(SAMPLED_FRAMES, frames)).astype(int))
    for index in looks:
        ids = source.ids(int(index))
        assert ids is not None  # sources know identities of all frames or of none
        more = int(ids.max()) + 1 - len(best)
        best = np.concatenate([best, np.full(max(more, 0), -1.0)])
        np.maximum.at(best, ids, _weights(source, source.frame(int(index))))
    seen = np.flatnonzero(best >= 0)
    order = seen[np.argsort(best[seen], kind="stable")]
    return np.sort(order[: int(share * len(order))]).astype(np.int32)


def _weights(source: FrameSource, splats: Splats) -> NDArray[np.float64]:
    return contributions(splats, cameras_around(source.focus, source.up, SAMPLED_VIEWS), create("auto"))


def _pictures(splats: Splats, cameras: list[Camera], rasteriser: Rasteriser) -> list[tuple[F32, F32]]:
    """Colours [H, W, 3] and alpha [H, W] of each view."""
    scene, options = rasteriser.load(splats), RenderOptions(depth=DepthKind.NONE)
    views = [scene.render(camera, options) for camera in cameras]
    return [(np.clip(view.rgb, 0, 1), view.alpha) for view in views]
