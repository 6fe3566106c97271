"""Crops of pairs, as bytes: small enough to keep thousands in memory, and exact enough (an 8-bit picture is 59 dB)."""

from __future__ import annotations

import os
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cags_client.restore.affine import AffineRestorer, AffineSettings
from cags_client.restore.networks.inputs import HALF, half_features, level_of
from cags_common.errors import SceneError
from cags_common.geometry import F32
from cags_common.metrics import COVERED_ALPHA
from cags_training.pairs.maker import Pair, PairMaker
from cags_training.pairs.settings import PairSettings

Bytes = NDArray[np.uint8]

COVERED_SHARE = 0.05
"""A crop is kept where at least this share of it is covered by the scene, if the view has any such place."""

SHOWN_SHARE = 0.01
"""A view is used where at least this share of it is covered."""

TRIES = 40


@dataclass(frozen=True, eq=False)
class Crops:
    """N crops of side S; rows belong together."""

    distorted: Bytes  # [N, S, S, 3]
    aligned: Bytes  # [N, S, S, 3]
    closed_form: Bytes  # [N, S, S, 3] what ``affine`` makes of it
    confidence: Bytes  # [N, S, S]
    truth: Bytes  # [N, S, S, 3]
    covered: Bytes  # [N, S, S] alpha of the truth
    features: NDArray[np.float16]  # [N, S / 2, S / 2, 10] what ``lite`` sees, cut from the whole picture's
    level: F32  # [N] how much the closed form changes the frame that the crop is of
    lod_share: F32  # [N] mean LoD over the highest

    def __len__(self) -> int:
        return len(self.truth)

    @staticmethod
    def concatenate(parts: Sequence[Crops]) -> Crops:
        """All crops of ``parts``, which have one side."""
        return Crops(*(np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(Crops)))

    def save(self, path: Path) -> None:
        """Write an ``.npz``, atomically."""
        path.parent.mkdir(parents=True, exist_ok=True)
        staged = path.with_name(f".{path.name}.{os.getpid()}.npz")
        try:
            np.savez(staged, **{f.name: getattr(self, f.name) for f in fields(self)})
            staged.replace(path)
        finally:
            staged.unlink(missing_ok=True)

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
            parts.append(crops_of(pair, settings.crops, settings.crop, rng))
            tell(len(parts), views)
        if len(parts) == views:
            break
    if not parts:
        raise SceneError("no view of the scene shows it; give walks that look at it, or another focus")
    return Crops.concatenate(parts)


def crops_of(pair: Pair, count: int, side: int, rng: np.random.Generator) -> Crops:
    """``count`` crops of a pair at drawn places that show something of the scene."""
    aligned = pair.inputs.aligned
    closed_form = AffineRestorer(AffineSettings(threads=1)).restore(pair.inputs)
    features = half_features(pair.inputs, closed_form)
    places = [_place(pair.truth_alpha, side, rng) for _ in range(count)]

    def cut(image: F32) -> Bytes:
        return np.stack([_as_bytes(image[y : y + side, x : x + side]) for y, x in places])

    return Crops(
        distorted=cut(pair.inputs.distorted),
        aligned=cut(aligned.rgb),
        closed_form=cut(closed_form),
        confidence=cut(aligned.confidence),
        truth=cut(pair.truth),
        covered=cut(pair.truth_alpha),
        features=np.stack([_half(features, y, x, side) for y, x in places]),
        level=np.full(count, level_of(features), np.float32),
        lod_share=np.full(count, pair.lod_share, np.float32),
    )


def _place(alpha: F32, side: int, rng: np.random.Generator) -> tuple[int, int]:
    """Top left corner: the most covered of the tries, or the first that is covered enough."""
    best, most = (0, 0), -1.0
    for _ in range(TRIES):
        y, x = (HALF * int(rng.integers((length - side) // HALF + 1)) for length in alpha.shape)
        covered = float((alpha[y : y + side : 4, x : x + side : 4] > COVERED_ALPHA).mean())
        if covered > most:
            best, most = (y, x), covered
        if most >= COVERED_SHARE:
            break
    return best


def _half(features: F32, y: int, x: int, side: int) -> NDArray[np.float16]:
    rows, columns = slice(y // HALF, (y + side) // HALF), slice(x // HALF, (x + side) // HALF)
    return features[rows, columns].astype(np.float16)


def _as_bytes(image: F32) -> Bytes:
    return np.asarray(np.rint(np.clip(image, 0, 1) * np.float32(255)), dtype=np.uint8)
