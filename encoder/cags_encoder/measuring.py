"""LoD orders by what each layer is worth in pictures of the clip itself (paper, supplement, "LoD Assignment").

For every attribute and number of layers, with all other attributes whole, the first frame is drawn from a few views.
Squared errors of attributes nearly add up, so the order that takes the largest fall of error a byte next is nearly the
best one. The gain of each level is then measured along that order. Unlike the paper no restoration runs in between:
which one a client runs, and on what reference, is not known here.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from cags_common.attributes import join_attributes
from cags_common.geometry import F32, Camera, Intrinsics, Pose, Vec3
from cags_common.lod import LodLayer, depths_at
from cags_common.metrics import covered_mask
from cags_common.morton import tile_ranges
from cags_common.raster import DepthKind, Rasteriser, RenderedView, RenderOptions
from cags_common.splats import Splats
from cags_common.tiles import KEY_TILE_SPLATS, encode_layer
from cags_encoder.svq_codec import SvqCodec

WIDTH_PX, HEIGHT_PX, FOV_RAD = 400, 300, math.radians(55)
VIEWS = 3
_DISTANCES = (1.4, 2.2)
"""Radii from the centre that views alternate between: inside the range where scenes have sensible views."""

_OPTIONS = RenderOptions(depth=DepthKind.NONE)


def measured(
    codec: SvqCodec,
    splats: Splats,
    cameras: Sequence[Camera],
    rasteriser: Rasteriser,
    tell: Callable[[int, int], None],
) -> SvqCodec:
    """The codec with its LoD order and gains measured on ``splats`` [n] seen by ``cameras``."""
    trial = _Trial(codec, splats, cameras, rasteriser)
    layers = [(b.attribute, layer) for b in codec.quantiser.books for layer in range(b.enhancement_layers)]
    steps, done = 2 * len(layers) + 2, 0

    def error(depths: Mapping[str, int]) -> float:
        nonlocal done
        done += 1
        tell(done, steps)
        return trial.error(depths)

    full = {book.attribute: book.enhancement_layers for book in codec.quantiser.books}
    floor = error(full)
    cut = {(name, layer): error({**full, name: layer}) for name, layer in layers}
    order = cheapest_first(cut, floor, full, trial.layer_bytes())
    errors = [error(depths_at(order, lod)) for lod in range(len(order) + 1)]
    gains = 10 * np.log10(np.array(errors[:-1]) / np.array(errors[1:]))
    return replace(codec, lod_order=order, lod_gains_db=tuple(round(float(gain), 4) for gain in gains))


def cheapest_first(
    errors: Mapping[tuple[str, int], float],
    floor: float,
    layers: Mapping[str, int],
    sizes: Mapping[tuple[str, int], int],
) -> tuple[LodLayer, ...]:
    """All layers, those first whose error falls most a byte, an attribute's in order.

    ``errors[attribute, k]`` is the squared error when only that attribute is cut to ``k`` layers, ``floor`` the one of
    all layers, ``sizes[attribute, k]`` the bytes of its layer ``k`` >= 1. Where a later layer is worth more than the
    one before (a hollow curve), both are weighed together.
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


def cameras_around(centre: Vec3, radius: float, up: Vec3, near: float) -> list[Camera]:
    """Views from around ``centre``, a little above it, looking at it."""
    upward = np.asarray(up) / np.linalg.norm(up)
    aside = np.cross(upward, np.eye(3)[np.argmin(np.abs(upward))])
    aside /= np.linalg.norm(aside)
    ahead = np.cross(upward, aside)
    height_rad = FOV_RAD * HEIGHT_PX / WIDTH_PX
    intrinsics = Intrinsics.of_fov(WIDTH_PX, HEIGHT_PX, FOV_RAD, height_rad)
    out = []
    for view in range(VIEWS):
        turn = 2 * math.pi * (view + 0.3) / VIEWS
        way = math.cos(turn) * aside + math.sin(turn) * ahead + 0.25 * upward
        x, y, z = np.asarray(centre) + radius * _DISTANCES[view % 2] * way
        out.append(Camera(intrinsics, Pose.looking_at((float(x), float(y), float(z)), centre, up), near))
    return out


class _Trial:
    """The splats at any depths, drawn and compared with the true ones."""

    def __init__(self, codec: SvqCodec, splats: Splats, cameras: Sequence[Camera], rasteriser: Rasteriser) -> None:
        self._books, self._cameras, self._rasteriser = codec.quantiser.books, cameras, rasteriser
        self._coded = codec.quantise(codec.prepare(splats))
        self._truth = self._draw(splats)

    def error(self, depths: Mapping[str, int]) -> float:
        """Mean squared error over covered pixels of all views, with ``depths[attribute]`` enhancement layers."""
        values = {}
        for book in self._books:
            layers = 1 + depths.get(book.attribute, 0)
            values[book.attribute] = book.lookup(book.prefix(self._coded.codes[book.attribute], layers), layers)
        total, pixels = 1e-9, 1
        for true, shown in zip(self._truth, self._draw(join_attributes(self._coded.means, values)), strict=True):
            mask = covered_mask(np.maximum(true.alpha, shown.alpha))
            total += float(np.square(_shown(true) - _shown(shown))[mask].sum())
            pixels += 3 * int(mask.sum())
        return total / pixels

    def layer_bytes(self) -> dict[tuple[str, int], int]:
        """Bytes of each enhancement layer of the frame's tiles."""
        out = {}
        for book in self._books:
            codes = self._coded.codes[book.attribute]
            for layer in range(1, book.enhancement_layers + 1):
                bits, part = book.layer_bits[layer], book.layer(codes, layer)
                tiles = tile_ranges(len(part), KEY_TILE_SPLATS)
                out[book.attribute, layer] = sum(len(encode_layer(part[a:b], bits)) for a, b in tiles)
        return out

    def _draw(self, splats: Splats) -> list[RenderedView]:
        scene = self._rasteriser.load(splats)
        return [scene.render(camera, _OPTIONS) for camera in self._cameras]


def _shown(view: RenderedView) -> F32:
    return np.clip(view.rgb, 0, 1)
