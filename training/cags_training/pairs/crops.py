"""Crops of pairs, as bytes: small enough to keep thousands in memory, and exact enough (an 8-bit picture is 59 dB)."""

from __future__ import annotations

import zipfile
from collections.abc import Callable, Sequence
from dataclasses import astuple, dataclass, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cags_client.restore.affine import AffineSettings, correction_fields, own_view, registration
from cags_common.errors import SceneError
from cags_common.files import whole_file
from cags_common.geometry import F32
from cags_common.metrics import COVERED_ALPHA
from cags_training.pairs.maker import Pair, PairMaker
from cags_training.pairs.settings import PairSettings

Bytes = NDArray[np.uint8]

POSITION_PX = 1 / 256
"""Step of positions in the reference's patch."""

BLOCK_PX = 16
"""Patches of references begin at whole macroblocks, so that the codec's grid lies alike in all of them."""

COVERED_SHARE = 0.05
"""A crop is kept where at least this share of it is covered by the scene, if the view has any such place."""

SHOWN_SHARE = 0.01
"""A view is used where at least this share of it is covered."""

TRIES = 40


@dataclass(frozen=True, eq=False)
class Crops:
    """N crops of side S of clients' pictures and, of side R, of their references around them; rows belong together."""

    distorted: Bytes  # [N, S, S, 3]
    aligned: Bytes  # [N, S, S, 3]
    closed_form: Bytes  # [N, S, S, 3] what ``affine`` makes of it
    confidence: Bytes  # [N, S, S]
    truth: Bytes  # [N, S, S, 3]
    covered: Bytes  # [N, S, S] alpha of the truth
    x: NDArray[np.uint16]  # [N, S, S] where pixels lie in the reference's patch, in POSITION_PX
    y: NDArray[np.uint16]  # [N, S, S]
    weight: Bytes  # [N, S, S] how far a correction counts; 0 outside the patch
    own: Bytes  # [N, R, R, 3] the client's splats seen from the reference
    reference: Bytes  # [N, R, R, 3]
    clean: Bytes  # [N, R, R, 3] the reference before it was coded
    fields: NDArray[np.float16]  # [N, R, R, 4] of the closed form
    noise: F32  # [N, 6] fine, then broad (CodingNoise)
    lod_share: F32  # [N] mean LoD over the highest

    def __len__(self) -> int:
        return len(self.truth)

    @staticmethod
    def concatenate(parts: Sequence[Crops]) -> Crops:
        """All crops of ``parts``, which have the same sides."""
        return Crops(*(np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(Crops)))

    def save(self, path: Path) -> None:
        """Write an ``.npz``, atomically."""
        path.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(path) as writing, writing.open("wb") as file:
            np.savez(file, **{f.name: getattr(self, f.name) for f in fields(self)})

    @staticmethod
    def load(path: Path) -> Crops:
        """Inverse of :meth:`save`. Raises :class:`SceneError` for a damaged file."""
        try:
            with path.open("rb") as opened, np.load(opened, allow_pickle=False) as file:
                return Crops(*(file[f.name] for f in fields(Crops)))
        except (OSError, ValueError, KeyError, zipfile.BadZipFile) as error:
            raise SceneError(f"{path}: holds no training crops ({error}); delete it to make them anew") from error


def make_crops(
    maker: PairMaker, settings: PairSettings, rng: np.random.Generator, tell: Callable[[int, int], None]
) -> Crops:
    """The crops of ``settings.views`` drawn views; ``tell(done, total)`` is called after each view.

    Views that hardly show the scene are drawn again, at most as often as there are views.
    """
    parts: list[Crops] = []
    views = settings.views
    for _ in range(2 * views):
        pair = maker.draw(rng)
        if (pair.truth_alpha > COVERED_ALPHA).mean() >= SHOWN_SHARE:
            parts.append(crops_of(pair, settings, rng))
            tell(len(parts), views)
        if len(parts) == views:
            break
    if not parts:
        raise SceneError("no view of the scene shows it; give walks that look at it, or another focus")
    return Crops.concatenate(parts)


def crops_of(pair: Pair, settings: PairSettings, rng: np.random.Generator) -> Crops:
    """``settings.crops`` crops of a pair at drawn places that show something of the scene."""
    whole = _Whole.of(pair)
    h, w = whole.own.shape[:2]
    side = min(settings.reference_crop, h // BLOCK_PX * BLOCK_PX, w // BLOCK_PX * BLOCK_PX)
    rows = []
    for _ in range(settings.crops):
        top, left = _place(pair.truth_alpha, settings.crop, rng)
        rows.append(_crop(pair, whole, np.s_[top : top + settings.crop, left : left + settings.crop], side))
    return Crops(*(np.stack(column) for column in zip(*rows, strict=True)))


@dataclass(frozen=True, eq=False)
class _Whole:
    """What the closed form makes of a whole pair."""

    own: F32  # [h, w, 3]
    fields: F32  # [h, w, 4]
    weight: F32  # [H, W]
    restored: F32  # [H, W, 3]

    @staticmethod
    def of(pair: Pair) -> _Whole:
        settings, inputs = AffineSettings(threads=1), pair.inputs
        own = own_view(inputs)
        found = correction_fields(own, inputs.reference, settings)
        weight = inputs.aligned.confidence * registration(inputs, own, found, settings.misregistration)
        return _Whole(own, found, weight, pair.corrected(found, weight))


def _crop(pair: Pair, whole: _Whole, area: tuple[slice, slice], side: int) -> tuple[NDArray[np.generic], ...]:
    """One row of :class:`Crops`, in the order of its fields."""
    inputs = pair.inputs
    aligned, reference = inputs.aligned, inputs.reference
    x, y, weight = aligned.x[area], aligned.y[area], whole.weight[area]
    left, top = (_start(c, weight, side, n) for c, n in zip((x, y), whole.own.shape[1::-1], strict=True))
    patch = np.s_[top : top + side, left : left + side]
    inside = (x >= left) & (x <= left + side) & (y >= top) & (y <= top + side)
    return (
        *(_as_bytes(a[area]) for a in (inputs.distorted, aligned.rgb, whole.restored, aligned.confidence)),
        *(_as_bytes(a[area]) for a in (pair.truth, pair.truth_alpha)),
        *(_positions(np.where(inside, c - first, 0)) for c, first in ((x, left), (y, top))),
        _as_bytes(np.where(inside, weight, 0)),
        *(_as_bytes(a[patch]) for a in (whole.own, reference.rgb, pair.clean)),
        whole.fields[patch].astype(np.float16),
        np.array(astuple(reference.noise), np.float32).reshape(-1),
        np.array(pair.lod_share, np.float32),
    )


def _start(positions: F32, weight: F32, side: int, length: int) -> int:
    """First row or column of a patch of ``side`` around ``positions``, a multiple of a macroblock."""
    seen = positions[weight > 0]
    middle = float(np.median(seen)) if seen.size else length / 2
    last = (length - side) // BLOCK_PX
    return BLOCK_PX * int(np.clip(round((middle - side / 2) / BLOCK_PX), 0, last))


def _place(alpha: F32, side: int, rng: np.random.Generator) -> tuple[int, int]:
    """Top left corner: the most covered of the tries, or the first that is covered enough."""
    best, most = (0, 0), -1.0
    for _ in range(TRIES):
        y, x = (int(rng.integers(length - side + 1)) for length in alpha.shape)
        covered = float((alpha[y : y + side : 4, x : x + side : 4] > COVERED_ALPHA).mean())
        if covered > most:
            best, most = (y, x), covered
        if most >= COVERED_SHARE:
            break
    return best


def _positions(c: F32) -> NDArray[np.uint16]:
    return np.asarray(np.rint(c / np.float32(POSITION_PX)), dtype=np.uint16)


def _as_bytes(image: F32) -> Bytes:
    return np.asarray(np.rint(np.clip(image, 0, 1) * np.float32(255)), dtype=np.uint8)
