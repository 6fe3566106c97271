"""Crops of pairs, as bytes: small enough to keep thousands in memory, and exact enough (an 8-bit picture is 59 dB)."""

from __future__ import annotations

import zipfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cags_common.errors import SceneError
from cags_common.files import whole_file
from cags_common.geometry import F32
from cags_common.metrics import COVERED_ALPHA
from cags_research.training.pairs.maker import Pair, PairMaker
from cags_research.training.pairs.settings import PairSettings

Bytes = NDArray[np.uint8]

COVERED_SHARE = 0.05
"""A crop is kept where at least this share of it is covered by the scene, if the view has any such place."""

SHOWN_SHARE = 0.01
"""A view is used where at least this share of it is covered."""

TRIES = 40


@dataclass(frozen=True, eq=False)
class Crops:
    """N crops of side S of clients' views; rows belong together."""

    distorted: Bytes  # [N, S, S, 3]
    aligned: Bytes  # [N, S, S, 3]
    confidence: Bytes  # [N, S, S]
    truth: Bytes  # [N, S, S, 3]
    covered: Bytes  # [N, S, S] alpha of the truth
    expected_db: F32  # [N] PSNR expected of the client's whole view (RestoreInput.expected_db)
    ladder: F32  # [N] mean LoD of the tiles, as a share of the ladder

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

    Raises what :func:`pairs_of_views` does.
    """
    parts: list[Crops] = []
    for done, pairs in enumerate(pairs_of_views(maker, settings, rng), 1):
        parts += crops_of(pairs, settings, rng)
        tell(done, settings.views)
    return Crops.concatenate(parts)


def pairs_of_views(maker: PairMaker, settings: PairSettings, rng: np.random.Generator) -> Iterator[list[Pair]]:
    """The pairs of each of ``settings.views`` drawn views: one for each of the settings' levels, or one.

    Views that hardly show the scene are drawn again, at most as often as there are views. Raises :class:`SceneError`
    where none shows it.
    """
    done = 0
    for _ in range(2 * settings.views):
        pairs = maker.draw_levels(rng, settings.level_list) if settings.level_list else [maker.draw(rng)]
        if (pairs[0].truth_alpha > COVERED_ALPHA).mean() >= SHOWN_SHARE:
            yield pairs
            done += 1
        if done == settings.views:
            return
    if not done:
        raise SceneError("no view of the scene shows it; give walks that look at it, or another focus")


def crops_of(pairs: Sequence[Pair], settings: PairSettings, rng: np.random.Generator) -> list[Crops]:
    """``settings.crops`` crops of each of some pairs of one view, at the same drawn places that show the scene."""
    places = [_place(pairs[0].truth_alpha, settings.crop, rng) for _ in range(settings.crops)]
    areas = [np.s_[top : top + settings.crop, left : left + settings.crop] for top, left in places]
    return [_crops_at(areas, pair) for pair in pairs]


def _crops_at(areas: Sequence[tuple[slice, slice]], pair: Pair) -> Crops:
    inputs = pair.inputs
    return Crops(
        distorted=_cut(inputs.distorted, areas),
        aligned=_cut(inputs.aligned.rgb, areas),
        confidence=_cut(inputs.aligned.confidence, areas),
        truth=_cut(pair.truth, areas),
        covered=_cut(pair.truth_alpha, areas),
        expected_db=np.full(len(areas), inputs.expected_db, np.float32),
        ladder=np.full(len(areas), pair.ladder, np.float32),
    )


def _cut(image: F32, areas: Sequence[tuple[slice, slice]]) -> Bytes:
    """The same ``areas`` of an image in [0, 1], as bytes."""
    return np.stack([np.asarray(np.rint(np.clip(image[area], 0, 1) * np.float32(255)), np.uint8) for area in areas])


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
