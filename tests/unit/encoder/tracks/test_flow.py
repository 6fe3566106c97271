"""How far a splat moves, by those around it."""

import numpy as np
import pytest

from cags_encoder.tracks import flow
from cags_encoder.tracks.flow import FIELD_RIDGE, FIELD_ROUNDS, field_at, middle_at


def test_a_linear_field_is_taken_where_one_holds_and_the_median_elsewhere() -> None:
    rng = np.random.default_rng(3)
    points = rng.uniform(-1, 1, (400, 3))
    places = rng.uniform(-0.8, 0.8, (50, 3))
    near = np.argsort(np.linalg.norm(points[None] - places[:, None], axis=2), axis=1)[:, :16]
    turn = np.array([[0.0, -0.4, 0.1], [0.4, 0.0, 0.0], [-0.1, 0.0, 0.0]])
    moved = points @ turn.T + [1.0, 0, 0]
    moved[rng.permutation(400)[:40]] += rng.normal(size=(40, 3))  # a tenth is linked wrongly
    found = field_at(places, points, moved, near)
    assert np.median(np.linalg.norm(found - (places @ turn.T + [1.0, 0, 0]), axis=1)) < 0.01
    noise = rng.normal(size=(400, 3))
    assert np.allclose(field_at(places, points, noise, near), np.median(noise[near], axis=1))


def fitted(places: np.ndarray, points: np.ndarray, moved: np.ndarray, near: np.ndarray) -> np.ndarray:
    """The readable definition of the field at one place after another: normal equations as matrices."""
    out = []
    for place, around in zip(places, near, strict=True):
        apart, values = points[around] - place, moved[around]
        middle = np.median(values, axis=0)
        unit = max(np.sqrt((apart**2).sum(axis=1).mean()), flow.TINY)
        design = np.concatenate([np.ones((len(around), 1)), apart / unit], axis=1)
        before = off = np.linalg.norm(values - middle, axis=1)
        for _ in range(FIELD_ROUNDS):
            weights = 1 / (1 + (off / max(2 * np.median(off), flow.TINY)) ** 2)
            normal = design.T @ (weights[:, None] * design) + FIELD_RIDGE * len(around) * np.diag([0, 1, 1, 1])
            fit = np.linalg.solve(normal, design.T @ (weights[:, None] * values))
            off = np.linalg.norm(values - design @ fit, axis=1)
        out.append(fit[0] if np.median(off) < flow.FIELD_HOLDS * np.median(before) else middle)
    return np.array(out)


@pytest.mark.parametrize("count", [1, 2, 5, 16])
def test_fields_are_those_of_the_normal_equations(count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(flow, "PIECE", 13)
    rng = np.random.default_rng(count)
    points, places = rng.normal(size=(60, 3)), rng.normal(size=(40, 3))
    moved = points @ rng.normal(size=(3, 3)) + 0.02 * rng.normal(size=(60, 3))
    near = np.argsort(np.linalg.norm(points[None] - places[:, None], axis=2), axis=1)[:, :count]
    assert np.allclose(field_at(places, points, moved, near), fitted(places, points, moved, near), atol=1e-9)
    assert np.array_equal(middle_at(places, points, moved, near), np.median(moved[near], axis=1))


@pytest.mark.parametrize("flat", [(1, 1, 0), (1, 0, 0), (0, 0, 0)])
def test_points_on_a_plane_a_line_or_at_one_place_have_fields_of_any_size(flat: tuple[int, int, int]) -> None:
    rng = np.random.default_rng(1)
    points = rng.normal(size=(80, 3)) * flat
    near = np.argsort(np.linalg.norm(points[None] - points[:, None], axis=2), axis=1, kind="stable")[:, :16]
    for size in (1e-9, 1.0, 1e6):
        moved = size * (points @ np.array([[0.0, 0.1, 0], [-0.1, 0, 0], [0, 0, 0]]) + [0.3, 0, 0])
        found = field_at(size * points, size * points, moved, near)
        off = np.linalg.norm(found - moved, axis=1) / size
        assert np.median(off) < 1e-3  # the ridge holds slopes back a little
        assert off.max() < 0.05  # at the edge, where all neighbours lie on one side


def test_of_no_places_there_are_no_fields() -> None:
    none, rows = np.zeros((0, 3)), np.zeros((0, 16), np.intp)
    assert field_at(none, np.ones((20, 3)), np.ones((20, 3)), rows).shape == (0, 3)
    assert middle_at(none, np.ones((20, 3)), np.ones((20, 3)), rows).shape == (0, 3)
