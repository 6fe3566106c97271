"""Random clips: whatever is shuffled, born, ends, moves and fades, continuing splats are linked."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from cags_common.splats import Splats
from cags_encoder.tracks.identity import IdentityTracker
from cags_encoder.tracks.linking import Looks, Tracks, link
from cags_encoder.tracks.looking import Look
from support.codec_scenes import cloud, with_changes
from support.tracked_clips import TrueFrame, linked


def clip(seed: int, count: int, turnover: float, speed: float, degree: int, size: float) -> list[TrueFrame]:
    """Splats that drift at speeds of their own around a common one; a share of them ends and begins in each frame."""
    rng, frames = np.random.default_rng(seed), 5
    every = cloud(count * (frames + 1), seed, degree)
    every = with_changes(every, means=every.means * size, log_scales=every.log_scales + np.log(size))
    velocity = speed * size * (rng.normal(size=3) + 0.02 * rng.normal(size=(len(every.means), 3)))
    alive, fresh, out = np.arange(count), count, []
    for k in range(frames):
        if k:
            ends = rng.random(count) < turnover
            alive = np.r_[alive[~ends], np.arange(fresh, fresh + ends.sum())]
            fresh += int(ends.sum())
        order = rng.permutation(alive)
        means = every.means + (k * velocity).astype(np.float32)
        opacities = every.logit_opacities + rng.normal(size=len(every)).astype(np.float32)
        out.append((with_changes(every, means=means, logit_opacities=opacities).take(order), order))
    return out


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    count=st.sampled_from([100, 400, 1500]),
    turnover=st.sampled_from([0.0, 0.1, 0.3, 0.5]),
    speed=st.sampled_from([0.0, 1e-9, 0.01, 0.2, 1.0]),
    degree=st.integers(0, 3),
    size=st.sampled_from([1e-4, 1.0, 1e5]),
)
def test_continuing_splats_are_linked(
    seed: int, count: int, turnover: float, speed: float, degree: int, size: float
) -> None:
    score = linked(clip(seed, count, turnover, speed, degree, size))
    assert score.found >= 0.95
    assert score.false <= 0.03 + 0.05 * turnover


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_any_two_frames_are_linked_one_to_one(data: st.DataObject) -> None:
    """Rows are distinct and in range, whatever the frames: values far apart, all at one place, of absurd sizes."""

    def frame() -> Splats:
        count = data.draw(st.integers(1, 30))
        splats = cloud(count, data.draw(st.integers(0, 3)))
        scale = data.draw(st.sampled_from([0.0, 1e-30, 1.0, 1e30]))
        size = data.draw(st.sampled_from([-80.0, 0.0, 80.0]))
        return with_changes(splats, means=splats.means * scale, log_scales=splats.log_scales + size)

    before, after = frame(), frame()
    rows = link(Tracks.begun(Looks.of(before)), Looks.of(after))
    found = rows[rows >= 0]
    assert len(rows) == len(after)
    assert len(np.unique(found)) == len(found)
    assert found.max(initial=-1) < len(before)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 1000), counts=st.lists(st.integers(1, 60), min_size=2, max_size=8))
def test_identities_are_distinct_and_never_come_back(seed: int, counts: list[int]) -> None:
    rng, base = np.random.default_rng(seed), cloud(60, seed)
    frames = [("x", Look(base.take(rng.permutation(60)[:count]), None)) for count in counts]
    dead: set[int] = set()
    before: set[int] = set()
    for count, frame in zip(counts, IdentityTracker().follow(frames), strict=True):
        now = set(frame.ids.tolist())
        assert len(now) == count
        assert not now & dead
        dead |= before - now
        before = now
