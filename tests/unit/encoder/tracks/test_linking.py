"""Splats are linked to their predecessors under many kinds of change."""

import numpy as np
import pytest

from cags_common.splats import Splats
from cags_encoder.tracks.linking import Looks, Tracks, link
from support.codec_scenes import cloud, with_changes
from support.tracked_clips import TrueFrame, disguised, linked

RNG = np.random.default_rng(0)


def links(before: Splats, after: Splats) -> np.ndarray:
    return link(Tracks.begun(Looks.of(before)), Looks.of(after))


def moved(splats: Splats, by: object) -> Splats:
    return with_changes(splats, means=splats.means + np.asarray(by, np.float32))


def drifting(step: float, frames: int = 4, size: float = 1.0, degree: int = 0) -> list[TrueFrame]:
    """A shuffled cloud of ``size`` metres that moves by ``step`` metres per frame."""
    base = cloud(1500, 1, degree)
    base = with_changes(base, means=base.means * size, log_scales=base.log_scales + np.log(size))
    out = []
    for k in range(frames):
        order = RNG.permutation(len(base))
        out.append((moved(base, [step * k, 0, 0]).take(order), order))
    return out


@pytest.mark.parametrize("quantise", ["", ",quantise=sog", ",quantise=spz"])
def test_a_4d_clip_is_told_apart(quantise: str) -> None:
    score = linked(disguised("fourd:splats=6000,births=750,frames=5" + quantise))
    assert score.found >= 0.95
    assert score.false <= 0.01


@pytest.mark.parametrize("quantise", ["", ",quantise=sog"])
def test_the_moving_room_is_told_apart(quantise: str) -> None:
    score = linked(disguised("procedural:size=6000,frames=4" + quantise))
    assert score.found >= 0.95
    assert score.false <= 0.02


def test_rows_that_hold_are_found_without_a_fault() -> None:
    score = linked(disguised("procedural:size=3000,frames=4", shuffle=False))
    assert score.found >= 0.99
    assert score.false <= 0.005


@pytest.mark.parametrize("step", [0.0, 1e-9, 0.01, 0.3, 2.0, 50.0])
@pytest.mark.parametrize("degree", [0, 2])
def test_a_cloud_may_drift_or_leap(step: float, degree: int) -> None:
    score = linked(drifting(step, degree=degree))
    assert score.found >= 0.99
    assert score.false <= 0.01


@pytest.mark.parametrize("size", [1e-6, 1e6])
def test_the_unit_of_length_does_not_matter(size: float) -> None:
    score = linked(drifting(0.05 * size, size=size))
    assert score.found >= 0.99
    assert score.false <= 0.01


def test_a_frame_twice_is_the_same_splats() -> None:
    splats = cloud(400)
    assert np.array_equal(links(splats, splats), np.arange(400))
    order = RNG.permutation(400)
    assert np.array_equal(links(splats, splats.take(order)), order)


def test_splats_that_swap_their_rows_are_seen_through() -> None:
    splats = cloud(400)
    rows = np.arange(400)
    rows[[10, 20, 30, 31]] = rows[[20, 10, 31, 30]]
    assert np.array_equal(links(splats, moved(splats, 0.001).take(rows)), rows)


def test_splats_that_swap_their_places_are_seen_through() -> None:
    splats = cloud(400)
    means = splats.means.copy()
    means[:100] = means[:100] * 0.01  # close together
    splats = with_changes(splats, means=means)
    means = means.copy()
    means[[3, 4]] = means[[4, 3]]
    assert np.array_equal(links(splats, with_changes(splats, means=means)), np.arange(400))


def test_two_splats_at_one_place_are_told_by_their_looks() -> None:
    splats = cloud(400)
    means = splats.means.copy()
    means[1], means[3] = means[0], means[2]
    twins = with_changes(splats, means=means)
    order = RNG.permutation(400)
    assert np.array_equal(links(twins, moved(twins, 0.002).take(order)), order)


def test_splats_that_are_the_same_in_everything_are_each_linked_once() -> None:
    one = cloud(1)
    many = one.take(np.zeros(12, np.intp))
    assert sorted(links(many, many)) == list(range(12))
    found = links(many, moved(many, 0.001))
    assert (found >= 0).sum() >= 6
    assert len(np.unique(found[found >= 0])) == (found >= 0).sum()


def test_a_splat_that_jumps_across_the_scene_is_another() -> None:
    splats = cloud(400)
    means = splats.means + np.float32(0.001)
    means[7] += 50
    found = links(splats, with_changes(splats, means=means))
    assert found[7] == -1
    assert np.array_equal(np.delete(found, 7), np.delete(np.arange(400), 7))


def test_nothing_connects_across_a_cut() -> None:
    other = cloud(400, 9)
    assert (links(cloud(400, 8), other) >= 0).mean() < 0.1
    assert (links(cloud(400, 8), moved(other, 1000)) == -1).all()


def test_half_may_go_and_as_many_may_come() -> None:
    whole = cloud(800)
    order = RNG.permutation(400)
    assert np.array_equal(links(whole, moved(whole, 0.001).take(order)), order)
    back = links(whole.take(np.arange(400)), moved(whole, 0.001))
    assert np.array_equal(back[:400], np.arange(400))
    assert (back[400:] >= 0).mean() < 0.05


def test_splats_fade_as_they_like() -> None:
    splats = cloud(400)
    order = RNG.permutation(400)
    faded = with_changes(moved(splats, 0.002), logit_opacities=RNG.normal(size=400))
    assert np.array_equal(links(splats, faded.take(order)), order)


def test_one_attribute_may_change_at_will() -> None:
    splats = cloud(400)
    order = RNG.permutation(400)
    for name in ("sh0", "log_scales"):
        changed = with_changes(splats, **{name: cloud(400, 5).sh0 - (4 if name == "log_scales" else 0)})
        assert np.array_equal(links(splats, changed.take(order)), order)


def test_lives_of_one_frame_are_not_linked() -> None:
    base = cloud(3000)
    standing, brief = base.take(np.arange(1000)), [base.take(np.arange(1000, 2000)), base.take(np.arange(2000, 3000))]
    ids = np.arange(3000)
    frames = [
        (Splats.concatenate([standing, brief[0]]), ids[:2000]),
        (Splats.concatenate([standing, brief[1]]), np.r_[ids[:1000], ids[2000:]]),
    ]
    score = linked(frames)
    assert score.found >= 0.99
    assert score.false <= 0.03  # a few of a thousand ending splats lie beside a similar new one


def test_single_splats_are_frames_too() -> None:
    one = cloud(1)
    assert links(one, moved(one, 0.001)).tolist() == [0]
    assert links(one, moved(one, 1e6)).tolist() == [-1]
    assert links(one, cloud(3)).tolist().count(0) <= 1


def test_linking_is_deterministic() -> None:
    frames = [splats for splats, _ in disguised("fourd:splats=2000,births=250,frames=2")]
    assert np.array_equal(links(*frames), links(*frames))


def test_a_surface_of_alike_splats_that_leaps_by_their_spacing_is_linked_by_its_flow() -> None:
    side, random = 40, np.random.default_rng(0)
    grid = np.stack(np.meshgrid(np.arange(side), np.arange(side)), axis=-1).reshape(-1, 2) + 0.2 * random.normal(
        size=(side * side, 2)
    )
    base = cloud(side * side, 0)
    alike = with_changes(
        base,
        means=np.concatenate([grid, 0 * grid[:, :1]], axis=1).astype(np.float32),
        quats=np.tile(np.float32([1, 0, 0, 0]), (len(base), 1)),
        log_scales=np.full((len(base), 3), np.log(0.2), np.float32),
        sh0=np.zeros((len(base), 3), np.float32),
    )
    push = 1.2 * np.clip(grid[:, :1] / side, 0, 1) ** 2 * np.array([[1.0, 0.0, 0.0]])
    order = random.permutation(len(base))
    rows = links(alike, moved(alike, push).take(order))
    assert np.mean(rows == order) >= 0.98


def test_neighbours_that_change_their_looks_and_move_together_are_no_strangers() -> None:
    rest, thing = cloud(2000, 0), cloud(60, 1)
    thing = with_changes(thing, means=0.02 * thing.means + np.float32([9, 0, 0]))
    before = Splats.concatenate([rest, thing])
    turned = with_changes(moved(thing, [0.05, 0.05, 0]), log_scales=thing.log_scales + np.float32(0.25))
    after = Splats.concatenate([rest, turned])
    order = np.random.default_rng(0).permutation(len(after))
    assert np.mean(links(before, after.take(order)) == order) >= 0.99


def rolling(frames: int, turn: float, step: float, seed: int = 2) -> list[TrueFrame]:
    """A shuffled ball of alike splats that turns by ``turn`` radians a frame and goes on by ``step`` of its radius."""
    rng = np.random.default_rng(seed)
    out: list[TrueFrame] = []
    n = 900
    at = np.arange(n) + 0.5
    height, angle = 1 - 2 * at / n, at * np.pi * (1 + 5**0.5)  # Fibonacci's sphere: neighbours are about 0.12 apart
    wide = np.sqrt(1 - height**2)
    ball = np.stack([wide * np.cos(angle), height, wide * np.sin(angle)], axis=1)
    splats = cloud(n, 1, 0)
    alike_ones = with_changes(
        splats,
        log_scales=np.full((n, 3), np.log(0.05), np.float32),
        quats=np.tile(np.array([1, 0, 0, 0], np.float32), (n, 1)),
        sh0=np.zeros((n, 3), np.float32),
    )
    for frame in range(frames):
        c, s = np.cos(turn * frame), np.sin(turn * frame)
        turned = ball @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]).T + [step * frame, 0, 0]
        order = rng.permutation(n)
        out.append((with_changes(alike_ones, means=turned.astype(np.float32)).take(order), order))
    return out


@pytest.mark.parametrize(("turn", "step"), [(0.08, 0.0), (0.08, 0.2), (0.1, 0.2)])
def test_a_ball_of_alike_splats_that_rolls_past_their_spacing_keeps_them(turn: float, step: float) -> None:
    score = linked(rolling(9, turn, step))
    assert score.found >= 0.99
    assert score.false <= 0.002
