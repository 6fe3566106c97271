"""Splats that move in a scene: as if they had been replaced, and colours apart from it stay."""

from __future__ import annotations

import numpy as np
import pytest

from cags_common.errors import SceneError
from cags_common.geometry import Camera, Intrinsics, Pose
from cags_common.raster import RenderOptions, create
from cags_common.splats import Splats

CAMERA = Camera(Intrinsics.of_fov(96, 64, 1.0, 0.7), Pose.identity())


def random_splats(seed: int, count: int = 3000, harmonics: int = 15) -> Splats:
    rng = np.random.default_rng(seed)
    quats = rng.normal(size=(count, 4))
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    columns = {
        "means": rng.normal(size=(count, 3)) + np.array([0, 0, 5]),
        "quats": quats,
        "log_scales": rng.normal(size=(count, 3)) * 0.5 - 3,
        "logit_opacities": rng.normal(size=count),
        "sh0": rng.normal(size=(count, 3)),
        "sh_rest": rng.normal(size=(count, harmonics, 3)) * 0.1,
    }
    return Splats(**{name: column.astype(np.float32) for name, column in columns.items()})


def moved(splats: Splats, rows: np.ndarray, seed: int) -> Splats:
    """Those at ``rows`` elsewhere, turned and of another opacity, every third of none."""
    other, new = random_splats(seed, len(splats)), splats.take(np.arange(len(splats)))
    for name in ("means", "quats", "logit_opacities"):
        getattr(new, name)[rows] = getattr(other, name)[rows]
    new.logit_opacities[rows[::3]] = -30.0
    new.logit_opacities[rows[1::3]] = splats.logit_opacities[rows[1::3]]
    return new


@pytest.mark.parametrize("backend", ["cpu", "oracle"])
@pytest.mark.parametrize("threads", [1, 2])
def test_a_move_is_an_update_of_the_same_splats_bit_by_bit(backend: str, threads: int) -> None:
    count = 3000 if backend == "cpu" else 60
    splats, rows = random_splats(1, count), np.arange(count)[count // 4 :: 2]
    by_move, by_update = create(backend).load(splats), create(backend).load(splats)
    for seed in (2, 3):
        new = moved(splats, rows, seed)
        by_move.move(rows, new, threads)
        by_update.update(rows, new)
        a, b = (scene.render(CAMERA, RenderOptions()) for scene in (by_move, by_update))
        np.testing.assert_array_equal(a.rgb, b.rgb)
        np.testing.assert_array_equal(a.depth, b.depth)


def test_rows_in_any_order_and_twice_move_alike_and_no_rows_change_nothing() -> None:
    splats, rows = random_splats(1), np.array([7, 3, 2000, 3, 8])
    scene, other = create("cpu").load(splats), create("cpu").load(splats)
    new = moved(splats, np.unique(rows), 2)
    scene.move(rows, new)
    scene.move(np.zeros(0, np.intp), splats)
    other.update(np.unique(rows), new)
    np.testing.assert_array_equal(scene.render(CAMERA, RenderOptions()).rgb, other.render(CAMERA, RenderOptions()).rgb)


@pytest.mark.parametrize("backend", ["cpu", "oracle"])
def test_what_cannot_be_drawn_is_named_and_changes_nothing(backend: str) -> None:
    splats = random_splats(1, 50)
    scene = create(backend).load(splats)
    before = scene.render(CAMERA, RenderOptions()).rgb
    for column in ("log_scales", "sh0", "sh_rest"):
        bad = random_splats(2, 50)
        getattr(bad, column)[20] = np.nan
        with pytest.raises(SceneError, match=column):
            scene.update(np.arange(50), bad)
        np.testing.assert_array_equal(scene.render(CAMERA, RenderOptions()).rgb, before)
    for column, value in (("means", np.nan), ("logit_opacities", np.nan), ("quats", 0.0), ("quats", np.inf)):
        bad = moved(splats, np.arange(50), 2)
        getattr(bad, column)[20] = value
        with pytest.raises(SceneError, match=column):
            scene.move(np.arange(50), bad)
        np.testing.assert_array_equal(scene.render(CAMERA, RenderOptions()).rgb, before)
    with pytest.raises(ValueError, match="49 splats for a scene of 50"):
        scene.move(np.arange(3), splats.take(np.arange(49)))
    with pytest.raises(IndexError):
        scene.move(np.array([50]), splats)
