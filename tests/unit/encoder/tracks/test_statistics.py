"""Statistics of tracks."""

from dataclasses import asdict

import numpy as np
import pytest

from cags_common.bundle.tracks import TrackStatistics
from cags_encoder.pipeline import SplatSequence
from cags_encoder.scenes import FrameSource, open_scene
from cags_encoder.tracks.identity import IdentityTracker
from cags_encoder.tracks.looking import Look
from cags_encoder.tracks.statistics import TrackCounter
from support.codec_scenes import cloud, with_changes


def track_statistics(source: FrameSource, frames: int | None = None) -> TrackStatistics:
    """Statistics of the tracks of ``source``, or of its first ``frames``."""
    tracker = IdentityTracker()
    count = len(source) if frames is None else min(frames, len(source))
    looks = ((f"{source.name}, frame {at}", Look(source.frame(at), source.ids(at))) for at in range(count))
    assert len(list(tracker.follow(looks))) == count
    return tracker.statistics()


def test_lives_and_links_are_counted() -> None:
    counter, splats = TrackCounter(), cloud(5)
    frames = [[-1, -1, -1], [0, 1], [0, -1, -1], [0, 1, 2], [2]]  # rows of the previous frame
    before = None
    for rows in frames:
        after = splats.take(np.arange(len(rows)))
        counter.add(before, after, np.array(rows))
        before = after
    found = counter.statistics()
    assert (found.frames, found.tracks) == (5, 5)
    assert found.linked_share == pytest.approx((2 + 1 + 3 + 1) / (2 + 3 + 3 + 1))
    assert found.life_mean_frames == pytest.approx((4 + 2 + 1 + 2 + 3) / 5)
    assert found.life_histogram == (1, 3, 1)


@pytest.mark.parametrize(
    ("attribute", "changes"),
    [
        ("position", {"means": 0.1}),
        ("scale", {"log_scales": 0.3}),
        ("opacity", {"logit_opacities": 1.5}),
        ("colour", {"sh0": 0.5}),
        ("harmonics", {"sh_rest": 0.3}),
    ],
)
def test_the_attribute_that_changes_is_named(attribute: str, changes: dict[str, float]) -> None:
    base = cloud(300, 1, 1)
    base = with_changes(base, logit_opacities=np.full(300, 1.0))
    more = {name: getattr(base, name) + np.float32(by) for name, by in changes.items()}
    found = track_statistics(SplatSequence((base, base, with_changes(base, **more))))
    assert found.linked_share == 1
    assert {name: share for name, share in asdict(found.changed).items() if share} == {attribute: 0.5}


def test_a_4d_clip_moves_and_fades_and_keeps_its_looks() -> None:
    found = track_statistics(open_scene("fourd:splats=2000,births=250,frames=12,shuffle=1"))
    assert found.linked_share == pytest.approx(1 - 250 / 2000, abs=0.02)
    changed = found.changed
    assert changed.position > 0.1
    assert changed.opacity > 0.5
    assert max(changed.rotation, changed.scale, changed.colour, changed.harmonics) < 0.01


def test_one_frame_is_a_clip_too() -> None:
    found = track_statistics(open_scene("procedural:size=600,frames=3"), 1)
    assert (found.frames, found.linked_share, found.life_mean_frames) == (1, 0.0, 1.0)
    assert set(asdict(found.changed).values()) == {0.0}
