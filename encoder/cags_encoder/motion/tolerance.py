"""Accuracy of a clip's motion: in proportion to the accuracy of its looks, so that motion never limits quality.

The first frame is drawn with quantised looks, and with noise added to positions and rotations. The tolerance is the
noise whose error is a small share of the quantisation error, at the base and with every level. The accuracy of each
chunk then follows from its own errors (:mod:`cags_encoder.motion.chunks`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from cags_common.geometry import F32, F64, Camera
from cags_common.metrics import covered_mask
from cags_common.motion.apply import Steps, product
from cags_common.raster import DepthKind, Rasteriser, RenderedView, RenderOptions
from cags_common.splats import Splats
from cags_common.tiles.attributes import join_attributes
from cags_common.tiles.morton import morton_order
from cags_encoder.codecs.svq import SvqCodec, SvqSplats

SHARES = 0.2, 0.4
"""Shares of the squared error of quantised looks that positions, and rotations, may add: at the base and at the top."""

ALIKE, RUN = (0.6, 0.25), 8
"""Share of the noise's variance that neighbours have in common, at the base and at the top, and how many do: motion is
predicted from neighbours, and so are its errors. As measured on a head, a plant, a room and *monkey*.
"""

LEAST_SHARE = 0.05
"""If a smaller share of the splats moves, the tolerance grows no further."""

SPARE = 0.55
"""A level stays empty if the error without it is below this share of the tolerance."""

TRIES = 3
"""Iterations for the noise that gives an error: the error grows nearly with the square of the noise."""

_OPTIONS = RenderOptions(depth=DepthKind.NONE)


@dataclass(frozen=True)
class Tolerance:
    """Allowed root mean square error of a tile's samples, in finest units."""

    base: float = 8.0
    """With level 0 alone."""
    top: float = 0.5
    """With every level."""
    spare: float = 0.25
    """Below this error further levels stay empty."""


@dataclass(frozen=True)
class Tolerances:
    """Tolerances of positions and rotations. The defaults, if nothing was measured, follow from the levels' units."""

    moves: Tolerance = Tolerance()
    turns: Tolerance = Tolerance()

    def over(self, share: float) -> Tolerances:
        """Tolerances if only this ``share`` of the splats moves, so that only they have errors."""
        more = max(share, LEAST_SHARE) ** -0.5
        return Tolerances(*(Tolerance(t.base * more, t.top * more, t.spare) for t in (self.moves, self.turns)))


@dataclass(frozen=True)
class Looked:
    """How the test views are rendered, and the error that they already have."""

    cameras: Sequence[Camera]
    rasteriser: Rasteriser
    wrong: float
    """Largest error of colours, 0 to 1, of splats that are not updated; errors are evenly distributed up to it."""


def tolerances(codec: SvqCodec, splats: Splats, steps: Steps, looked: Looked) -> Tolerances:
    """Tolerances for prepared ``splats`` [n] with units ``steps``."""
    trial = _Trial(splats, looked)
    coded = codec.quantise(splats)
    coded = replace(coded, means=codec.means_at(coded))
    shown = _at_base(codec, coded), codec.decode(coded)
    base, top = (share * (trial.error(copy) + looked.wrong**2 / 3) for share, copy in zip(SHARES, shown, strict=True))
    noises = [_noise_alike(splats.means, alike) for alike in ALIKE]

    def moved(noise: F64) -> Splats:
        means = splats.means + noise * steps.moves[:, None].astype(np.float64)
        return replace(splats, means=means.astype(np.float32))

    def turned(noise: F64) -> Splats:
        turn = np.concatenate([np.ones((len(splats), 1)), noise * steps.turns[:, None]], axis=1)
        quats = product(turn, splats.quats.astype(np.float64))
        quats /= np.linalg.norm(quats, axis=1, keepdims=True)
        return replace(splats, quats=quats.astype(np.float32))

    def error(changed: Callable[[F64], Splats], noise: F64, size: float) -> float:
        return trial.error(changed(size * noise))

    def tolerance(changed: Callable[[F64], Splats]) -> Tolerance:
        pairs = zip(noises, (base, top), strict=True)
        at_base, at_top = (_size(partial(error, changed, noise), allowed) for noise, allowed in pairs)
        return Tolerance(at_base, at_top, SPARE * at_top)

    return Tolerances(tolerance(moved), tolerance(turned))


def _noise_alike(means: F32, alike: float) -> F64:
    """Noise [n, 3] of variance one, of which runs of neighbours share the part ``alike``."""
    random, n = np.random.default_rng(0), len(means)
    order = morton_order(means)
    common = np.empty((n, 3))
    common[order] = np.repeat(random.normal(size=(-(-n // RUN), 3)), RUN, axis=0)[:n]
    noise: F64 = np.sqrt(alike) * common + np.sqrt(1 - alike) * random.normal(size=(n, 3))
    return noise


def _size(error: Callable[[float], float], allowed: float) -> float:
    """The size of the noise, in finest units, that gives the ``allowed`` error."""
    size = 1.0
    for _ in range(TRIES):
        size = float(np.clip(size * (allowed / max(error(size), 1e-15)) ** 0.5, 1e-3, 1e3))
    return size


def _at_base(codec: SvqCodec, coded: SvqSplats) -> Splats:
    books = codec.quantiser.books
    values = {book.attribute: book.lookup(book.prefix(coded.codes[book.attribute], 1), 1) for book in books}
    return join_attributes(coded.means, values)


class _Trial:
    """Compares views of changed splats with views of the unchanged ones."""

    def __init__(self, splats: Splats, looked: Looked) -> None:
        self._looked = looked
        self._truth = self._draw(splats)

    def error(self, splats: Splats) -> float:
        """Mean squared error of the views of ``splats`` over the pixels that the true splats cover."""
        total, pixels = 1e-12, 1e-9
        for true, shown in zip(self._truth, self._draw(splats), strict=True):
            mask: NDArray[np.bool_] = covered_mask(true.alpha)
            total += float(np.square(_shown(true) - _shown(shown))[mask].mean(axis=1).sum())
            pixels += int(mask.sum())
        return total / pixels

    def _draw(self, splats: Splats) -> list[RenderedView]:
        scene = self._looked.rasteriser.load(splats)
        return [scene.render(camera, _OPTIONS) for camera in self._looked.cameras]


def _shown(view: RenderedView) -> F32:
    return np.clip(view.rgb, 0, 1)
