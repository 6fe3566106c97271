"""The generated 4D clip, and scenes with shuffled rows and quantised attributes."""

import pickle
from dataclasses import fields

import numpy as np
import pytest

from cags_common.errors import ConfigError
from cags_common.tiles.morton import morton_order
from cags_encoder.formats.sog import parse_sog_bytes
from cags_encoder.formats.sog_writer import quantised_as_sog, sog_bytes
from cags_encoder.formats.spz import parse_spz, quantised_as_spz, spz_bytes
from cags_encoder.scenes import open_scene
from cags_encoder.scenes.disguised import DisguiseOptions
from cags_encoder.scenes.options import EVERYWHERE
from support.splat_files import random_splats

SPEC = "fourd:splats=3000,births=300,frames=12,seed=4"


def test_as_many_splats_live_come_and_go_as_asked() -> None:
    scene = open_scene(SPEC)
    counts, births = [], []
    before = scene.ids(0)
    for k in range(12):
        splats, ids = scene.frame(k), scene.ids(k)
        assert len(splats) == len(ids) == len(np.unique(ids))
        counts.append(len(ids))
        births.append(len(np.setdiff1d(ids, before)))
        before = ids
    assert np.mean(counts) == pytest.approx(3000, rel=0.02)
    assert np.mean(births[1:]) == pytest.approx(300, rel=0.03)


def test_splats_move_in_lines_fade_and_keep_their_looks() -> None:
    scene = open_scene(SPEC)
    frames, ids = [scene.frame(k) for k in range(3)], [scene.ids(k) for k in range(3)]
    common = ids[0]
    for more in ids[1:]:
        common = np.intersect1d(common, more)
    a, b, c = (f.take(np.searchsorted(i, common)) for f, i in zip(frames, ids, strict=True))
    assert len(common) > 1500
    assert a.means + c.means == pytest.approx(2 * b.means, abs=1e-5)
    assert np.abs(a.means - b.means).max() > 1e-3
    for name in ("quats", "log_scales", "sh0", "sh_rest"):
        assert getattr(a, name) == pytest.approx(getattr(b, name), abs=1e-6)
    assert (np.abs(a.logit_opacities - b.logit_opacities) > 1e-3).mean() > 0.9


def test_the_same_options_give_the_same_bits_in_any_order() -> None:
    scene, other = open_scene(SPEC), pickle.loads(pickle.dumps(open_scene(SPEC)))
    for k in (11, 0, 5):
        for (_, mine), (_, theirs) in zip(scene.frame(k).arrays(), other.frame(k).arrays(), strict=True):
            assert np.array_equal(mine, theirs)
    assert not np.array_equal(open_scene(SPEC + "1").frame(0).means[:5], scene.frame(0).means[:5])


def test_one_frame_lives_and_a_single_birth_a_frame_are_clips_too() -> None:
    brief, few = open_scene("fourd:splats=200,births=200,degree=0"), open_scene("fourd:splats=100,births=1,frames=2")
    assert len(np.intersect1d(brief.ids(0), brief.ids(5))) == 0
    assert len(few.frame(1)) == len(few.ids(1)) >= 1


@pytest.mark.parametrize("spec", ["fourd:splats=200,births=201", "fourd:births=1000000,splats=1000000,frames=90000"])
def test_impossible_clips_are_refused(spec: str) -> None:
    with pytest.raises(ConfigError, match="births = "):
        open_scene(spec)


def test_shuffled_rows_are_the_same_splats_in_an_order_of_each_frame_alone() -> None:
    plain, mixed = open_scene(SPEC), open_scene(SPEC + ",shuffle=1")
    assert mixed.ids(3) is None
    orders = [mixed.order(k, 3000) for k in (3, 4)]
    assert not np.array_equal(*orders)
    frame, order = plain.frame(3), mixed.order(3, len(plain.frame(3)))
    assert np.array_equal(mixed.frame(3).means, frame.means[order])
    assert np.array_equal(mixed.frame(3).means, open_scene(SPEC + ",shuffle=1").frame(3).means)


def test_any_scene_can_be_disguised() -> None:
    assert tuple(f.name for f in fields(DisguiseOptions)) == EVERYWHERE
    room = open_scene("procedural:size=600,frames=3,shuffle=1,quantise=spz")
    assert len(room) == 3
    assert len(np.unique(room.frame(0).log_scales)) < 600
    with pytest.raises(ConfigError, match="quantise = 'jpeg'"):
        open_scene("procedural:size=600,quantise=jpeg")


@pytest.mark.parametrize("degree", [0, 3])
def test_quantising_as_a_format_is_what_its_files_bring_back(degree: int) -> None:
    splats = random_splats(300, degree)
    pairs = [
        (quantised_as_spz(splats).checked("x"), parse_spz(spz_bytes(splats), "x")),
        (
            quantised_as_sog(splats.take(morton_order(splats.means))).checked("x"),
            parse_sog_bytes(sog_bytes(splats), "x"),
        ),
    ]
    for k, (mine, theirs) in enumerate(pairs):
        for (name, a), (_, b) in zip(mine.arrays(), theirs.arrays(), strict=True):
            coarse = (
                k == 0 and name == "sh_rest"
            )  # our files have more bits for harmonics than those of Niantic's tools
            assert a == pytest.approx(b, abs=0.07 if coarse else 2e-6), name
