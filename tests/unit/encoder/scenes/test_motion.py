"""Added motion: selected attributes change, everything else is bit-identical, identities persist."""

import pickle
from itertools import pairwise

import numpy as np
import pytest

from cags_common.geometry import F64
from cags_common.splats import Splats
from cags_encoder.scenes.harmonics import basis
from cags_encoder.scenes.motion import KINDS, MotionOptions, MotionScene
from cags_encoder.scenes.source import Focus, focus_of
from support.splat_files import random_splats

REST = random_splats(400, 2)


class Still:
    """A capture of one frame."""

    name, fps, up = "cloud", 30.0, (0.0, 0.0, 1.0)

    def __init__(self, splats: Splats = REST) -> None:
        self._splats = splats

    @property
    def focus(self) -> Focus:
        return focus_of(self._splats)

    def __len__(self) -> int:
        return 1

    def frame(self, index: int) -> Splats:
        return self._splats

    def ids(self, index: int) -> None:
        return None


def scene(kind: str = "mix", base: Splats = REST, **options: float) -> MotionScene:
    return MotionScene(Still(base), MotionOptions(kind=kind, **options))  # type: ignore[arg-type]


def changed(source: MotionScene, a: int, b: int) -> tuple[set[str], float]:
    """Attributes that differ among the splats in both frames, and the share of splats that differ."""
    ids_a, ids_b = source.ids(a), source.ids(b)
    _, rows_a, rows_b = np.intersect1d(ids_a, ids_b, return_indices=True)
    names, rows = set(), np.zeros(len(rows_a), bool)
    for (name, x), (_, y) in zip(source.frame(a).arrays(), source.frame(b).arrays(), strict=True):
        differs = (x[rows_a] != y[rows_b]).reshape(len(rows_a), -1).any(axis=1)
        if differs.any():
            names.add(name)
            rows |= differs
    return names, float(rows.mean())


@pytest.mark.parametrize(
    ("kind", "attributes"),
    [
        ("rigid", {"means", "quats", "sh_rest"}),
        ("bend", {"means", "quats", "sh_rest"}),
        ("colour", {"sh0", "sh_rest"}),
        ("appear", set()),
    ],
)
def test_each_kind_changes_its_attributes_of_its_share(kind: str, attributes: set[str]) -> None:
    names, share = changed(scene(kind, share=0.2), 3, 9)
    assert names == attributes
    assert share <= 0.2 + 1e-9
    if attributes:
        assert share > 0.15


def test_splats_come_and_go_under_the_same_identity() -> None:
    source = scene("appear", share=0.5)
    sets = [set(source.ids(i).tolist()) for i in range(0, 60, 5)]
    assert any(b - a for a, b in pairwise(sets))
    assert any(a - b for a, b in pairwise(sets))
    for index in (0, 25):
        np.testing.assert_array_equal(source.frame(index).means, REST.means[source.ids(index)])


def test_mixed_motion_stays_within_its_share_and_moves_every_way() -> None:
    names, share = changed(scene(share=0.2), 0, 8)
    assert names == {"means", "quats", "sh0", "sh_rest"}
    assert 0.05 < share < 0.2


def test_rigid_motion_keeps_distances_and_turns_the_view_dependent_colour() -> None:
    source = scene("rigid", share=0.3)
    frame = source.frame(11)
    rows = np.flatnonzero((frame.means != REST.means).any(axis=1))
    a, b = REST.means[rows].astype(np.float64), frame.means[rows].astype(np.float64)
    distances = [np.linalg.norm(x[:, None] - x[None], axis=2) for x in (a, b)]
    np.testing.assert_allclose(*distances, atol=1e-5)
    rotation = best_rotation(a, b)
    directions = np.random.default_rng(0).normal(size=(len(rows), 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    before = np.einsum("nk,nkc->nc", basis(directions, 2)[:, 1:], REST.sh_rest[rows])
    after = np.einsum("nk,nkc->nc", basis(directions @ rotation.T, 2)[:, 1:], frame.sh_rest[rows])
    np.testing.assert_allclose(before, after, atol=1e-5)


def best_rotation(a: F64, b: F64) -> F64:
    """Kabsch algorithm: the rotation from the centred ``a`` to ``b``."""
    u, _, vt = np.linalg.svd((a - a.mean(0)).T @ (b - b.mean(0)))
    flip = np.diag([1.0, 1.0, np.linalg.det(vt.T @ u.T)])
    return np.asarray(vt.T @ flip @ u.T)


def test_bending_leaves_the_foot_and_moves_the_top() -> None:
    source = scene("bend", share=0.4)
    shift = np.linalg.norm(source.frame(14).means - REST.means, axis=1)
    height = REST.means[:, 2]
    moving = np.flatnonzero(shift)
    assert height[moving].min() > np.delete(height, moving).max() - 0.3  # the upper part
    top, foot = moving[np.argmax(height[moving])], moving[np.argmin(height[moving])]
    assert shift[top] > 5 * shift[foot]


@pytest.mark.parametrize("kind", KINDS)
def test_deterministic_periodic_and_picklable(kind: str) -> None:
    source, again = scene(kind, frames=90), scene(kind, frames=90)
    source.frame(3)
    sent = pickle.dumps(source)
    assert len(sent) < len(pickle.dumps(source._base)) + 1000, "workers read the capture themselves"
    copy = pickle.loads(sent)
    for other in (again, copy):
        for (_, x), (_, y) in zip(source.frame(17).arrays(), other.frame(17).arrays(), strict=True):
            np.testing.assert_array_equal(x, y)
    np.testing.assert_array_equal(source.ids(5), source.ids(65))  # one period of two seconds later
    assert changed(source, 5, 65)[1] < 0.2


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("count", [1, 2, 5])
@pytest.mark.parametrize("share", [0.0, 1.0])
def test_tiny_captures_and_extreme_shares(kind: str, count: int, share: float) -> None:
    source = scene(kind, REST.take(slice(0, count)), share=share, amount=0.5)
    for index in range(0, 60, 13):
        assert len(source.frame(index)) == len(source.ids(index)) > 0


def test_frames_outside_are_refused() -> None:
    source = scene(frames=5)
    for index in (-1, 5):
        with pytest.raises(IndexError):
            source.frame(index)
