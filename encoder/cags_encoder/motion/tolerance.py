"""How exactly a clip's motion has to be told: as its looks are, so that motion is never what makes a picture poor.

The first frame is drawn with its looks quantised, and with its splats shifted and turned by noise. The tolerance is the
noise whose error is a small part of quantisation's, at the base and with every level. Chunks are then told as exactly
as their own errors ask for (:mod:`cags_encoder.motion.chunks`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cags_common.geometry import F32, Camera
from cags_common.metrics import covered_mask
from cags_common.motion.apply import Steps, product
from cags_common.raster import DepthKind, Rasteriser, RenderedView, RenderOptions
from cags_common.splats import Splats
from cags_common.tiles.attributes import join_attributes
from cags_encoder.codecs.svq import SvqCodec, SvqSplats

SHARES = 0.2, 0.4
"""Parts of the squared error of quantised looks that motion, and that turning, may add: at the base and in all."""

LEAST_SHARE = 0.05
"""Of fewer moving splats each may not be more wrong."""

SPARE = 0.35
"""Levels tell nothing where without them errors are still this part of what is tolerable."""

TRIES = 3
"""Trials by which the noise of an error is found: errors grow nearly with its square."""

_OPTIONS = RenderOptions(depth=DepthKind.NONE)


@dataclass(frozen=True)
class Tolerance:
    """By how many finest units, in the root mean square, a tile's samples may be wrong."""

    base: float = 8.0
    """With level 0 alone."""
    top: float = 0.5
    """With every level."""
    spare: float = 0.25
    """So little that a level more is not told."""


@dataclass(frozen=True)
class Tolerances:
    """Tolerances of positions and rotations; unmeasured, those that the levels imply."""

    moves: Tolerance = Tolerance()
    turns: Tolerance = Tolerance()

    def over(self, share: float) -> Tolerances:
        """Tolerances if only a ``share`` of the splats moves, and errors occur there alone."""
        more = max(share, LEAST_SHARE) ** -0.5
        return Tolerances(*(Tolerance(t.base * more, t.top * more, t.spare) for t in (self.moves, self.turns)))


@dataclass(frozen=True)
class Looked:
    """What pictures are made of, and by what."""

    cameras: Sequence[Camera]
    rasteriser: Rasteriser
    wrong: float
    """By how much colours, 0 to 1, are wrong of splats that are not told anew: at most, evenly spread."""


def tolerances(codec: SvqCodec, splats: Splats, steps: Steps, looked: Looked) -> Tolerances:
    """Tolerances for prepared ``splats`` [n] with units ``steps``."""
    trial = _Trial(splats, looked)
    coded = codec.quantise(splats)
    grid = codec.grid(coded)
    coded = replace(coded, means=grid.dequantise(grid.quantise(coded.means)))
    shown = _at_base(codec, coded), codec.decode(coded)
    base, top = (share * (trial.error(copy) + looked.wrong**2 / 3) for share, copy in zip(SHARES, shown, strict=True))
    noise = np.random.default_rng(0).normal(size=(2, len(splats), 3))

    def moved(size: float) -> float:
        means = splats.means + noise[0] * steps.moves[:, None].astype(np.float64) * size
        return trial.error(replace(splats, means=means.astype(np.float32)))

    def turned(size: float) -> float:
        turn = np.concatenate([np.ones((len(splats), 1)), noise[1] * steps.turns[:, None] * size], axis=1)
        quats = product(turn, splats.quats.astype(np.float64))
        quats /= np.linalg.norm(quats, axis=1, keepdims=True)
        return trial.error(replace(splats, quats=quats.astype(np.float32)))

    return Tolerances(*(_tolerance(error, base, top) for error in (moved, turned)))


def _tolerance(error: Callable[[float], float], base: float, top: float) -> Tolerance:
    most = _noise(error, top)
    return Tolerance(_noise(error, base), most, SPARE * most)


def _noise(error: Callable[[float], float], allowed: float) -> float:
    """The noise, finest units, that gives the ``allowed`` error."""
    size = 1.0
    for _ in range(TRIES):
        size = float(np.clip(size * (allowed / max(error(size), 1e-15)) ** 0.5, 1e-3, 1e3))
    return size


def _at_base(codec: SvqCodec, coded: SvqSplats) -> Splats:
    books = codec.quantiser.books
    values = {book.attribute: book.lookup(book.prefix(coded.codes[book.attribute], 1), 1) for book in books}
    return join_attributes(coded.means, values)


class _Trial:
    """The splats as they are, to be compared with them changed."""

    def __init__(self, splats: Splats, looked: Looked) -> None:
        self._looked = looked
        self._truth = self._draw(splats)

    def error(self, splats: Splats) -> float:
        """Mean squared error of their pictures over what the true ones cover."""
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
