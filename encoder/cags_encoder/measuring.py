"""What pictures of the clip itself decide: the step of positions, and the order of layers by their gain (paper,
supplement, "LoD Assignment").

Where flat splats of different colours overlap, small errors of depth change which one is in front. The step of
positions is halved until that cannot be seen with all levels. Splats that move do not count here, because chunks of
motion code their positions more exactly than their looks do.

For the order, the first frame is drawn from a few views for every attribute and number of its layers, with all layers
of the other attributes. Squared errors of attributes nearly add up, so choosing the largest reduction per byte next is
nearly optimal. The gain of each level is then measured along that order. It ends where no visible error is left, or
where all further levels together bring too little: twice the bytes should at least halve the squared error. In most
clips a tenth more does; where harmonics, say, stay coarse for good, what refines the rest is wasted. Unlike in the
paper no restoration is applied, because the client's restorer and references are not known here.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol, Self, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from cags_common.bundle.quality import LayerQuality, LevelQuality, LodQuality
from cags_common.geometry import F32, Camera
from cags_common.metrics import covered_mask, ssim_map
from cags_common.raster import DepthKind, Rasteriser, RenderedView, RenderOptions
from cags_common.splats import Splats
from cags_common.tiles.attributes import join_attributes
from cags_common.tiles.lod import POSITION, LodLayer, depths_at, position_layers
from cags_common.tiles.morton import morton_order, tile_ranges
from cags_common.tiles.payloads import KEY_TILE_SPLATS
from cags_encoder.codecs.registry import ClipCodec
from cags_encoder.codecs.svq import SvqCodec, radii_of

VIEWS = 3

PATCH_PX, WORST = 8, 0.999
"""Side of the patches whose squared errors are compared, in pixels, and the quantile that counts: where splats change
their order, a patch appears and vanishes while the mean error of the picture stays small.
"""

POSITIONS_SHARE = 0.5
"""Largest error of a patch by rounded positions, as a share of that by looks with every layer."""

ENOUGH = 10 ** (-65.0 / 10)
"""Squared error at which the ladder ends. The rounding of an 8-bit display is four times as large (58.9 dB)."""

UNSEEN = 10 ** (-45.0 / 10)
"""Squared error of a patch that is tolerable whatever the looks are."""

FINEST = 1 / 8
"""Smallest step of positions, in steps of the configuration. Each halving takes a level of 3 bits a splat."""

LAGS = (1, 4, 16)
"""Frames apart, of pairs of frames that are compared to see what standing still costs."""

_OPTIONS = RenderOptions(depth=DepthKind.NONE)


@dataclass(frozen=True)
class LodMeasurement:
    """The measured order and its gains, and the step of positions."""

    order: tuple[LodLayer, ...]
    gains_db: tuple[float, ...]
    """PSNR gained by each level of :attr:`order`."""
    quality: LodQuality
    position_step: float

    def applied(self, codec: SvqCodec) -> SvqCodec:
        """``codec`` with this order and step, without the layers that the order leaves out."""
        return replace(
            codec,
            quantiser=codec.quantiser.truncated(depths_at(self.order, len(self.order))),
            lod_order=self.order,
            lod_gains_db=self.gains_db,
            base_psnr_db=self.quality.ladder[0].psnr_db,
            position_step=self.position_step,
        )


def measure(
    codec: SvqCodec,
    splats: Splats,
    cameras: Sequence[Camera],
    rasteriser: Rasteriser,
    tell: Callable[[int, int], None],
    *,
    still: NDArray[np.bool_],
    refine: bool = False,
    later: Iterable[Splats] = (),
) -> LodMeasurement:
    """The best LoD order of ``codec`` for ``splats`` [n] seen by ``cameras``, and the gain of each level.

    With ``refine`` the step of positions becomes as fine as those of ``still`` [n] splats need. The order ends as the
    module says, for ``splats`` and for ``later`` frames.
    """
    trial = _Trial(codec, splats, cameras, rasteriser, still)
    if refine:
        trial.refine()
    full = trial.layers
    layers = [(name, layer) for name, end in full.items() for layer in range(end)]
    steps, done = 2 * len(layers) + 2, 0

    def look(depths: Mapping[str, int]) -> _Seen:
        nonlocal done
        done += 1
        tell(done, steps)
        return trial.look(depths)

    best, sizes = look(full), trial.layer_bytes()
    cut = {(name, layer): look({**full, name: layer}) for name, layer in layers}
    order = cheapest_first({at: seen.error for at, seen in cut.items()}, best.error, full, sizes)
    levels = [look(depths_at(order, lod)) for lod in range(len(order) + 1)]
    totals = np.cumsum([trial.base_bytes(), *(sizes[item.attribute, item.layer] for item in order)])
    kept = _enough(order, levels, totals, later, lambda frame: _Trial(trial.codec, frame, cameras, rasteriser))
    order, levels = order[:kept], levels[: kept + 1]
    errors = np.array([seen.error for seen in levels])
    gains = tuple(round(float(gain), 4) for gain in 10 * np.log10(errors[:-1] / errors[1:]))
    alone = [
        LayerQuality(
            name, layer, sizes.get((name, layer), 0), *(best if layer == full[name] else cut[name, layer]).rounded()
        )
        for name in full
        for layer in range(full[name] + 1)
    ]
    ladder = [
        LevelQuality(lod, int(total), *seen.rounded())
        for lod, (total, seen) in enumerate(zip(totals[: kept + 1], levels, strict=True))
    ]
    left_out = full.get(POSITION, 0) - position_layers(order)
    step = trial.codec.position_step * 2**left_out
    return LodMeasurement(order, gains, LodQuality(tuple(alone), tuple(ladder)), step)


def _enough(
    order: Sequence[LodLayer],
    levels: Sequence[_Seen],
    totals: NDArray[np.int64],
    later: Iterable[Splats],
    trial: Callable[[Splats], _Trial],
) -> int:
    """Number of levels of ``order`` that are worth their bytes: in the first frame, whose ``levels`` with ``totals``
    bytes are given, and in ``later`` ones. Those are not drawn if the first frame needs every level.
    """
    longer = totals[-1] / totals
    kept = next(lod for lod, seen in enumerate(levels) if seen.error <= max(ENOUGH, levels[-1].error * longer[lod]))
    for splats in later if kept < len(order) else ():
        shown = trial(splats)
        least = shown.look(depths_at(order, len(order))).error
        while kept < len(order) and shown.look(depths_at(order, kept)).error > max(ENOUGH, least * longer[kept]):
            kept += 1
    return kept


def standing(splats: Splats, later: Splats, codec: SvqCodec) -> NDArray[np.bool_]:
    """Which ``splats`` [n] stand still: some splat of a ``later`` frame is where they are."""
    from scipy.spatial import cKDTree

    if not len(later):
        return np.zeros(len(splats), np.bool_)
    away, _ = cKDTree(later.means).query(splats.means)
    still: NDArray[np.bool_] = away < codec.position_step / 4 * radii_of(splats)
    return still


def standing_still(
    frame: Callable[[int], Splats], frames: int, cameras: Sequence[Camera], rasteriser: Rasteriser
) -> tuple[tuple[int, float], ...]:
    """(frames, PSNR): what is left of a picture's quality if nothing moves for so many frames of a clip of ``frames``,
    whose splats ``frame(number)`` returns; by rising frames. Pairs of frames begin or end at the first frame and in the
    middle of the clip. Empty for a single frame.
    """
    squared: dict[int, list[float]] = {}
    for at in {0, frames // 2} if frames > 1 else ():
        views = _Views(frame(at), cameras, rasteriser)
        for lag in LAGS:
            other = at + lag if at + lag < frames else at - lag
            if other >= 0:
                squared.setdefault(lag, []).append(views.look(frame(other)).error)
    return tuple((lag, round(-10 * math.log10(float(np.mean(errors))), 3)) for lag, errors in sorted(squared.items()))


@runtime_checkable
class Levelled(ClipCodec, Protocol):
    """A codec of fixed levels, whose quality can be measured."""

    def levels(self, coded: Any) -> Iterable[Splats]:
        """What a decoder shows of one tile at each LoD, from 0 on."""
        ...

    def with_measured(self, psnr_db: tuple[float, ...]) -> Self:
        """The same codec, which knows the PSNR of each LoD from 0 on, or of none."""
        ...


def measured_levels(
    codec: Levelled, splats: Splats, cameras: Sequence[Camera], rasteriser: Rasteriser
) -> tuple[float, ...]:
    """PSNR of each LoD of ``codec`` from 0 on for ``splats`` [n] seen by ``cameras``."""
    views = _Views(splats, cameras, rasteriser)
    coded = codec.quantise(codec.prepare(views.splats))
    tiles = [codec.levels(coded.take(slice(a, b))) for a, b in tile_ranges(len(splats), KEY_TILE_SPLATS)]
    errors = np.array([views.look(Splats.concatenate(list(level))).error for level in zip(*tiles, strict=True)])
    return tuple(round(float(psnr_db), 4) for psnr_db in -10 * np.log10(errors))


def cheapest_first(
    errors: Mapping[tuple[str, int], float],
    floor: float,
    layers: Mapping[str, int],
    sizes: Mapping[tuple[str, int], int],
) -> tuple[LodLayer, ...]:
    """All layers by falling reduction of error per byte, with the layers of each attribute in order.

    ``errors[attribute, k]`` is the squared error with ``k`` layers of that attribute and all layers of the others,
    ``floor`` the error with all layers, ``sizes[attribute, k]`` the bytes of its layer ``k`` >= 1. If a later layer
    gains more per byte than the one before it, both are treated as one.
    """
    depth, order = dict.fromkeys(layers, 0), []
    while any(depth[name] < layers[name] for name in layers):
        best: tuple[float, str, int] | None = None
        for name, end in layers.items():
            for to in range(depth[name] + 1, end + 1):
                fall = errors[name, depth[name]] - (errors[name, to] if to < end else floor)
                worth = fall / sum(sizes[name, layer] for layer in range(depth[name] + 1, to + 1))
                if best is None or worth > best[0]:
                    best = worth, name, to
        assert best is not None
        _, name, to = best
        order += [LodLayer(name, layer) for layer in range(depth[name] + 1, to + 1)]
        depth[name] = to
    return tuple(order)


@dataclass(frozen=True)
class _Seen:
    """Quality of a trial against the truth."""

    error: float
    """Mean squared error over covered pixels of all views."""
    ssim: float

    def rounded(self) -> tuple[float, float]:
        """PSNR in dB and SSIM."""
        return round(-10 * math.log10(self.error), 3), round(self.ssim, 5)


class _Views:
    """Renders compared with the truth."""

    def __init__(self, splats: Splats, cameras: Sequence[Camera], rasteriser: Rasteriser) -> None:
        self._cameras, self._rasteriser = cameras, rasteriser
        self.order = morton_order(splats.means)
        self.splats = splats.take(self.order)
        """The truth, in the order of tiles."""
        self._truth = self._draw(self.splats)

    def look(self, shown_splats: Splats) -> _Seen:
        """Compare ``shown_splats`` over the covered pixels of all views."""
        total, likeness, pixels = 1e-9, 0.0, 1e-9
        for true, shown in zip(self._truth, self._draw(shown_splats), strict=True):
            mask = covered_mask(np.maximum(true.alpha, shown.alpha))
            total += float(np.square(_shown(true) - _shown(shown))[mask].mean(axis=1).sum())
            likeness += float(ssim_map(shown.rgb, true.rgb)[mask].mean(axis=1).sum())
            pixels += int(mask.sum())
        return _Seen(total / pixels, likeness / pixels)

    def worst_patch(self, shown_splats: Splats) -> float:
        """Squared error of small squares of all views that one in a thousand exceeds."""
        patches = []
        for true, shown in zip(self._truth, self._draw(shown_splats), strict=True):
            errors = np.square(_shown(true) - _shown(shown)).mean(axis=2)
            rows, columns = (side // PATCH_PX for side in errors.shape)
            whole = errors[: rows * PATCH_PX, : columns * PATCH_PX]
            patches.append(whole.reshape(rows, PATCH_PX, columns, PATCH_PX).mean(axis=(1, 3)).ravel())
        return float(np.quantile(np.concatenate(patches), WORST))

    def _draw(self, splats: Splats) -> list[RenderedView]:
        scene = self._rasteriser.load(splats)
        return [scene.render(camera, _OPTIONS) for camera in self._cameras]


class _Trial:
    """Renders of the splats with any number of layers, compared with the truth."""

    def __init__(
        self,
        codec: SvqCodec,
        splats: Splats,
        cameras: Sequence[Camera],
        rasteriser: Rasteriser,
        still: NDArray[np.bool_] | None = None,
    ) -> None:
        """``still`` [n] splats are shown where their looks say; none unless given."""
        self.codec, self._books = _with_positions(codec), codec.quantiser.books
        self._views = _Views(splats, cameras, rasteriser)
        self._still = np.zeros(len(splats), np.bool_) if still is None else still[self._views.order]
        coded = codec.quantise(codec.prepare(self._views.splats))
        self._codes = coded.codes
        self._tiles = [coded.take(slice(a, b)) for a, b in tile_ranges(len(splats), KEY_TILE_SPLATS)]
        self._looks = codec.decode(coded)
        self._decoded: dict[int | None, F32] = {}

    @property
    def layers(self) -> dict[str, int]:
        """Enhancement layers of each attribute, and of positions, if they have any."""
        positions = max((self.codec.grid(tile).layers for tile in self._tiles), default=0)
        books = {book.attribute: book.enhancement_layers for book in self._books}
        return books | ({POSITION: positions} if positions else {})

    def refine(self) -> None:
        """Halve the step of positions until the worst patches show it at most half as much as the quantised looks, or
        the error cannot be seen.
        """
        looks = self._views.worst_patch(self._looks)
        allowed, finest = max(POSITIONS_SHARE * looks, UNSEEN), FINEST * self.codec.position_step
        while self.codec.position_step > finest:
            rounded = replace(self._views.splats, means=self._means(None))
            if self._views.worst_patch(rounded) <= allowed:
                break
            self.codec = _with_positions(replace(self.codec, position_step=self.codec.position_step / 2))
            self._decoded.clear()

    def _means(self, layers: int | None) -> F32:
        """Positions as decoded tile by tile with so many layers; None: with all."""
        whole = self._at(None)
        exact = np.where(self._still[:, None], whole, self._views.splats.means)
        return exact if layers is None else exact + (self._at(layers) - whole)

    def _at(self, layers: int | None) -> F32:
        if layers not in self._decoded:
            self._decoded[layers] = np.concatenate([self.codec.means_at(tile, layers) for tile in self._tiles])
        return self._decoded[layers]

    def look(self, depths: Mapping[str, int]) -> _Seen:
        """Compare with ``depths[attribute]`` enhancement layers."""
        values = {}
        for book in self._books:
            layers = 1 + depths.get(book.attribute, 0)
            values[book.attribute] = book.lookup(book.prefix(self._codes[book.attribute], layers), layers)
        return self._views.look(join_attributes(self._means(depths.get(POSITION, 0)), values))

    def base_bytes(self) -> int:
        """Bytes of LoD 0 of the frame's tiles."""
        return sum(map(self.codec.base_bytes, self._tiles))

    def layer_bytes(self) -> dict[tuple[str, int], int]:
        """Bytes of each enhancement layer of the frame's tiles."""
        items = [LodLayer(name, layer) for name, end in self.layers.items() for layer in range(1, end + 1)]
        return {(i.attribute, i.layer): sum(self.codec.layer_bytes(tile, i) for tile in self._tiles) for i in items}


def _with_positions(codec: SvqCodec) -> SvqCodec:
    """``codec`` with an order that has as many layers of positions as there may be, and all others in any order."""
    order = (item for item in codec.lod_order if item.attribute != POSITION)
    positions = (LodLayer(POSITION, layer) for layer in range(1, codec.finest_layers + 1))
    return replace(codec, lod_order=(*order, *positions))


def _shown(view: RenderedView) -> F32:
    return np.clip(view.rgb, 0, 1)
