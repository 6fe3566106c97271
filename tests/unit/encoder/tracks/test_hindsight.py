"""Links that later frames correct."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from cags_common.splats import Splats
from cags_encoder.tracks.hindsight import FRAMES, Linked, corrected, inverse
from cags_encoder.tracks.identity import IdentityTracker
from cags_encoder.tracks.linking import Looks, Tracks, link
from cags_encoder.tracks.looking import Look
from support.codec_scenes import cloud, with_changes
from support.tracked_clips import TrueFrame, disguised


def alike(count: int, seed: int = 0) -> Splats:
    """Splats that only their places tell apart, on a plane of a metre."""
    one = cloud(1, seed).take(np.zeros(count, np.intp))
    grid = int(np.ceil(count**0.5))
    places = np.stack([np.arange(count) % grid, np.arange(count) // grid, np.zeros(count)], axis=1) / grid
    return with_changes(one, means=places + np.random.default_rng(seed).normal(scale=0.1 / grid, size=places.shape))


def moved(splats: Splats, by: object) -> Splats:
    return with_changes(splats, means=splats.means + np.asarray(by, np.float32))


def begun(frames: list[Splats]) -> list[Linked]:
    """``frames`` linked one after the other, without hindsight."""
    looks = [Looks.of(splats) for splats in frames]
    out = [Linked(looks[0], np.full(len(frames[0]), -1, np.intp), Tracks.begun(looks[0]))]
    for after in looks[1:]:
        rows = link(out[-1].tracks, after)
        out.append(Linked(after, rows, out[-1].tracks.continued(after, rows)))
    return out


def right(frames: list[Linked]) -> list[float]:
    """Share of each frame's splats that continue their own row, of frames in one order."""
    return [float(np.mean(frame.rows == np.arange(len(frame.rows)))) for frame in frames[1:]]


def test_a_wrong_beginning_is_put_right_by_what_follows() -> None:
    """Some splats begin by moving to where their neighbours were: no later link is at fault."""
    splats = alike(400)
    clip = begun([moved(splats, [0.01 * k, 0, 0]) for k in range(3)])
    assert min(right(clip)) == 1.0
    clip[1].rows = np.r_[np.roll(np.arange(120), 1), np.arange(120, 400)]  # each continues the one beside it
    clip[1].tracks = clip[0].tracks.continued(clip[1].looks, clip[1].rows)
    assert corrected(clip)
    assert min(right(clip)) == 1.0
    assert all(np.allclose(frame.tracks.velocities, [0.01, 0, 0], atol=1e-5) for frame in clip[1:])


def test_links_that_nothing_contradicts_stay() -> None:
    splats = cloud(300)
    clip = begun([moved(splats, [0.01 * k, 0, 0]) for k in range(5)])
    before = [frame.rows.copy() for frame in clip]
    assert not corrected(clip)
    assert all(np.array_equal(frame.rows, rows) for frame, rows in zip(clip, before, strict=True))


def test_links_to_the_first_frame_are_final() -> None:
    splats = alike(100)
    clip = begun([moved(splats, [0.05 * k, 0, 0]) for k in range(4)])
    final = clip[0].rows = np.roll(np.arange(100), 1)
    corrected(clip)
    assert clip[0].rows is final


@pytest.mark.parametrize("speed", [0.09, 0.12])
def test_what_begins_in_motion_is_found_again_in_its_second_frame(speed: float) -> None:
    """A thing that appears at full speed has no way yet, and its neighbours, which stand still, mislead."""
    still, thing = cloud(500, 1), alike(200, 2)
    thing = moved(thing, np.random.default_rng(1).normal(scale=0.04, size=(200, 3)))
    there = [Splats.concatenate([still, moved(thing, [speed * k, 0.0, speed / 2 * k])]) for k in range(6)]
    lost = [200 * (1 - share) for share in right(begun([still, *there]))]
    assert lost[1] > 40
    ids = [frame.ids for frame in IdentityTracker().follow(("x", Look(splats, None)) for splats in [still, *there])]
    assert int((ids[1] != ids[2]).sum()) < 40
    assert all(np.array_equal(ids[2][:500], later[:500]) for later in ids[3:])


def faults(clip: list[TrueFrame], hindsight: bool) -> int:
    """Number of splats of ``clip`` that are linked wrongly or, though they continue, not at all."""
    looks = [Look(splats, None) for splats, _ in clip]
    if hindsight:
        ids = [frame.ids.tolist() for frame in IdentityTracker().follow(("x", look) for look in looks)]
        known = [{identity: row for row, identity in enumerate(frame)} for frame in ids[:-1]]
        rows = [np.array([of.get(i, -1) for i in frame]) for of, frame in zip(known, ids[1:], strict=True)]
    else:
        rows = [frame.rows for frame in begun([look.splats for look in looks])[1:]]
    found = 0
    for (_, before), (_, after), came in zip(clip[:-1], clip[1:], rows, strict=True):
        mine = np.where(came >= 0, before[came], -1)
        found += int((np.isin(after, before) & (mine != after)).sum())
    return found


@pytest.mark.parametrize("quantise", ["", ",quantise=sog"])
def test_a_room_has_fewer_faults_than_without(quantise: str) -> None:
    clip = disguised("procedural:size=30000,frames=7,seed=3" + quantise)
    assert faults(clip, True) < 0.7 * faults(clip, False)


@pytest.mark.parametrize("counts", [(3, 1, 2), (1, 1, 1, 1, 1), (2, 5, 2, 7, 1, 3)])
def test_frames_of_any_size_are_corrected(counts: tuple[int, ...]) -> None:
    """Few splats, at one place or not."""
    for size in (0.0, 1.0):
        frames = [with_changes(cloud(9, 1).take(slice(count)), means=size * cloud(9).means[:count]) for count in counts]
        clip = begun(frames)
        corrected(clip)
        for before, now in pairwise(clip):
            found = now.rows[now.rows >= 0]
            assert len(np.unique(found)) == len(found)
            assert found.max(initial=-1) < len(before.looks)


def test_an_inverse_goes_both_ways() -> None:
    rows = np.array([4, -1, 0, 2])
    assert inverse(rows, 6).tolist() == [2, -1, 3, -1, 0, -1]
    assert np.array_equal(inverse(inverse(rows, 6), 4), rows)


def test_some_frames_are_looked_ahead() -> None:
    """The links of a frame are final when that many came after it."""
    taken: list[int] = []
    splats = cloud(30)

    def coming() -> object:
        for at in range(9):
            taken.append(at)
            yield "x", Look(moved(splats, [0.01 * at, 0, 0]), None)

    followed = IdentityTracker().follow(coming())  # type: ignore[arg-type]
    assert [next(followed) and len(taken) for _ in range(4)] == [1, FRAMES + 2, FRAMES + 3, FRAMES + 4]
