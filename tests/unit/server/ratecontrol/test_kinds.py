"""Motion and updates beside looks, whatever the policy."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cags_common.tiles.kinds import TileKind
from cags_server.ratecontrol import Decision, Observation, TileView, create_rate_policy
from cags_server.ratecontrol.base import UNBOUNDED_BYTES, motion_density
from cags_server.ratecontrol.utility import absent, errors_of, grown, left_by

FRAME = 20
LOOKS = TileView(0, 0, 1, 50, (400, 60, 60, 60), weight=50.0, frames_left=30.0)
CHUNK = TileView(18, 1, 0, 50, (100, 150), weight=50.0, frames_left=8.0, stale_frames=2.0, kind=TileKind.MOTION)
UPDATE = TileView(19, 2, 0, 10, (50, 0, 40, 0), weight=10.0, frames_left=20.0, kind=TileKind.UPDATE)
POLICIES = ["utility", "paper", "buffer"]


def decide(policy: str, budget: int, *tiles: TileView) -> Decision:
    return create_rate_policy(policy).decide(Observation(FRAME, budget, tiles, (2.0, 2.0, 2.0), 10))


def levels(decision: Decision) -> dict[tuple[int, int], tuple[int, int]]:
    return {(u.frame, u.tile): (u.from_lod, u.to_lod) for u in decision.upgrades}


@pytest.mark.parametrize("policy", POLICIES)
def test_with_room_for_all_everything_goes(policy: str) -> None:
    sent = levels(decide(policy, UNBOUNDED_BYTES, LOOKS, CHUNK, UPDATE))
    assert sent == {(0, 0): (1, 4), (18, 1): (0, 2), (19, 2): (0, 4)}


@pytest.mark.parametrize("policy", POLICIES)
def test_motion_of_which_more_is_seen_than_of_its_looks_goes_with_them(policy: str) -> None:
    """Ghosts count for the one and not for the other."""
    lacking, looks = replace(CHUNK, after=(0, 0), visible=80), replace(LOOKS, depth=0)
    assert set(levels(decide(policy, UNBOUNDED_BYTES, lacking, looks))) == {(0, 0), (18, 1)}


@pytest.mark.parametrize("policy", ["utility", "paper"])
def test_what_stands_still_is_moved_before_what_is_there_is_refined(policy: str) -> None:
    assert levels(decide(policy, 115, LOOKS, CHUNK)) == {(18, 1): (0, 1)}


@pytest.mark.parametrize(("errors", "first"), [((0.001, 0.004), (0, 0)), ((10.0, 40.0), (18, 1))])
def test_where_little_moves_looks_are_refined_first(errors: tuple[float, float], first: tuple[int, int]) -> None:
    measured = tuple(zip((1.0, 16.0), errors, strict=True))
    observation = Observation(FRAME, 115, (LOOKS, CHUNK), (2.0, 2.0, 2.0), 10, still_errors=measured)
    assert create_rate_policy("utility").decide(observation).upgrades[0].frame == first[0]


def updates(observation: Observation) -> list[tuple[int, int]]:
    """LoDs of the update that go at once, and all that go."""
    decided = create_rate_policy("utility").decide(observation).upgrades
    return [(u.together, u.to_lod) for u in decided if (u.frame, u.tile) == (UPDATE.frame, UPDATE.tile)]


@pytest.mark.parametrize(("around", "together"), [(4, 4), (3, 3), (1, 1)])
def test_an_update_comes_at_once_as_good_as_what_is_around(around: int, together: int) -> None:
    """Once colours stood at their lowest level for some frames, at 39 dB, in a picture of 50."""
    update, looks = replace(UPDATE, lod_bytes=(50, 0, 40, 30)), replace(LOOKS, depth=around, weight=0.01)
    seen = Observation(FRAME, 130, (update, looks), (9.0, 9.0, 9.0), 10, outdated_errors=((1.0, 4.0),))
    assert updates(seen) == [(together, 4)]
    assert updates(replace(seen, timely_bytes=sum(update.lod_bytes[:together]) + 9)) == [], "it would come late"


def test_an_update_larger_than_any_budget_comes_as_far_as_it_is_better_than_what_is_old() -> None:
    update = replace(UPDATE, lod_bytes=(50, 0, 40, 30), frames_left=1.0)
    looks = replace(LOOKS, depth=4, weight=0.01)
    for outdated, least, size in ((4.0, 1, 60), (0.5, 3, 100)):
        for budget in range(0, 130, 5):
            seen = Observation(FRAME, budget, (update, looks), (9.0, 9.0, 9.0), 10, outdated_errors=((1.0, outdated),))
            sent = updates(seen)
            assert len(sent) == (budget >= size)
            assert all(together == least for together, _ in sent)


def test_coarse_motion_that_is_worse_than_standing_still_does_not_go_without_the_finer() -> None:
    still = ((1.0, 0.3), (16.0, 0.6))
    for budget in range(0, 400, 10):
        observation = Observation(FRAME, budget, (CHUNK,), (2.0, 2.0, 2.0), 10, still_errors=still)
        decided = levels(create_rate_policy("utility").decide(observation))
        assert decided == ({(18, 1): (0, 2)} if budget >= 260 else {})


POINTS = st.lists(st.floats(0, 1e3), min_size=2, max_size=5).map(
    lambda errors: tuple((4.0**at, error) for at, error in enumerate(sorted(errors)))
)


@given(POINTS, st.floats(0, 1e4), st.floats(0, 1e4))
def test_being_out_of_date_for_longer_is_never_better_and_never_worse_than_a_hole(
    points: tuple[tuple[float, float], ...], some: float, more: float
) -> None:
    less, later = (grown(frames, points) for frames in sorted((some, more)))
    assert 0 <= less <= later + 1e-9 and later <= 100.0
    assert all(grown(frames, points) == pytest.approx(min(error, 100.0)) for frames, error in points)


def test_the_error_of_standing_still_stays_where_what_moves_comes_back() -> None:
    there_and_back = ((1.0, 0.5), (4.0, 2.0), (16.0, 0.25))
    assert grown(16, there_and_back) == grown(40, there_and_back) == 0.25
    assert grown(10, there_and_back) == pytest.approx(1.125)


def test_empty_levels_of_motion_say_nothing_of_those_before() -> None:
    """A chunk of two levels and one of which two more are empty are worth the same."""
    padded = replace(CHUNK, lod_bytes=(*CHUNK.lod_bytes, 0, 0))
    gains = (1.0, 0.5, 0.25, 0.125)
    assert left_by(padded, gains)[:2] == left_by(CHUNK, gains)
    assert left_by(padded, gains)[2:] == (gains[-1], gains[-1])


@pytest.mark.parametrize("policy", POLICIES)
@pytest.mark.parametrize("budget", [0, 105, 300, 410, 425, 520, 525, 600, 10_000])
def test_motion_never_goes_without_its_looks(policy: str, budget: int) -> None:
    lacking = replace(CHUNK, after=(0, 0))
    order = [(u.frame, u.tile) for u in decide(policy, budget, lacking, replace(LOOKS, depth=0)).upgrades]
    assert (18, 1) not in order or order.index((0, 0)) < order.index((18, 1))


def test_motion_of_looks_that_nobody_plans_stays() -> None:
    assert decide("utility", 10_000, replace(CHUNK, after=(0, 0))).upgrades == ()


def test_the_longer_something_stands_still_the_sooner_it_is_moved() -> None:
    other = replace(CHUNK, tile=5, stale_frames=9.0)
    assert levels(decide("utility", 115, CHUNK, other)) == {(18, 5): (0, 1)}


def test_the_longer_updates_are_lacked_the_sooner_one_comes() -> None:
    """Once runs of eleven frames went without any, since one that lacked them all weighed as much as one of the first.

    Of a body that shrinks nothing was left by then (13 dB), though the link carried more bytes than they have.
    """
    longer = replace(UPDATE, tile=5, stale_frames=4.0)
    assert levels(decide("utility", 60, UPDATE, longer)) == {(19, 5): (0, 1)}
    measured = ((1.0, 0.01), (2.0, 0.02), (4.0, 9.0))
    for lacked, first in ((1.0, (18, 1)), (9.0, (19, 2))):
        update = replace(UPDATE, weight=50.0, frames_left=2.0, stale_frames=lacked)
        seen = Observation(
            FRAME, 115, (CHUNK, update), (), 10, still_errors=((1.0, 5.0), (16.0, 15.0)), outdated_errors=measured
        )
        sent = create_rate_policy("utility").decide(seen).upgrades[0]
        assert (sent.frame, sent.tile) == first


def test_the_tile_in_which_more_moves_is_moved_first() -> None:
    """A ball that rolls through one of four tiles of a room stood still, since each had a quarter of its motion."""
    rolls, rests = (replace(CHUNK, tile=tile, motion_bytes=moved) for tile, moved in ((7, 40.0), (1, 4.0)))
    density = motion_density((rolls, rests, LOOKS))
    assert density == pytest.approx(44.0 / 100.0)
    seen = Observation(FRAME, 115, (rests, rolls), (), 10, still_errors=((1.0, 1.5), (16.0, 3.0)))
    assert levels(create_rate_policy("utility").decide(seen)) == {(18, 1): (0, 1)}, "nothing tells"
    seen = replace(seen, motion_density=density)
    assert levels(create_rate_policy("utility").decide(seen)) == {(18, 7): (0, 1)}
    errors = errors_of(seen)
    whole = sum(tile.weight * absent(tile, errors) for tile in (rolls, rests)) / 100.0
    assert whole == pytest.approx(absent(CHUNK, replace(errors, motion_density=0.0))), "the picture's error stays"


def test_without_motion_there_is_no_density() -> None:
    assert motion_density(()) == motion_density((LOOKS, UPDATE)) == 0.0


def test_over_a_link_that_carries_a_part_of_all_updates_every_splat_gets_its_turn() -> None:
    """Where an update weighed the same however long none had come, the first tiles won in every frame."""
    lacked, longest = dict.fromkeys(range(6), 1.0), 0.0
    for frame in range(FRAME, FRAME + 30):
        tiles = tuple(
            replace(UPDATE, frame=frame, tile=tile, frames_left=1.0, stale_frames=since)
            for tile, since in lacked.items()
        )
        seen = Observation(frame, 130, tiles, (), 10, outdated_errors=((1.0, 0.5), (4.0, 9.0), (16.0, 40.0)))
        sent = {upgrade.tile for upgrade in create_rate_policy("utility").decide(seen).upgrades}
        assert sent
        lacked = {tile: 1.0 if tile in sent else since + 1 for tile, since in lacked.items()}
        longest = max(longest, *lacked.values())
    assert longest <= 4, "three frames carry all six"


def test_chunks_of_later_frames_come_after_those_of_now_and_before_idle() -> None:
    later = [replace(CHUNK, frame=FRAME + ahead, stale_frames=1.0) for ahead in (8, 2, 5)]
    order = [u.frame for u in decide("utility", 10_000, *later, CHUNK).upgrades]
    assert order == [18, FRAME + 2, FRAME + 5, FRAME + 8]


def test_a_chunk_that_is_larger_than_one_frames_budget_is_saved_for() -> None:
    large = replace(CHUNK, frame=FRAME + 4, lod_bytes=(900, 100), weight=5_000.0)
    assert decide("utility", 500, LOOKS, large).upgrades == (), "the budget is kept until it suffices"
    assert levels(decide("utility", 950, LOOKS, large)) == {(FRAME + 4, 1): (0, 1)}


def test_what_begins_later_need_not_arrive_before_the_display() -> None:
    later, now = replace(CHUNK, frame=FRAME + 3), CHUNK
    for tile, sent in ((later, 1), (now, 0)):
        observation = Observation(FRAME, 1000, (tile,), (), 10, timely_bytes=20)
        assert len(create_rate_policy("utility").decide(observation).upgrades) == sent


@pytest.mark.parametrize("policy", ["utility", "paper"])
def test_a_chunk_larger_than_any_budget_goes_alone(policy: str) -> None:
    """Once such a chunk waited, over an idle link, until it was late."""
    large = replace(CHUNK, frame=FRAME + 4, lod_bytes=(900, 950), weight=5_000.0)
    seen = Observation(FRAME, 500, (large, replace(LOOKS, weight=0.1)), (2.0, 2.0, 2.0), 10, alone_bytes=910)
    assert levels(create_rate_policy(policy).decide(seen)) == {(FRAME + 4, 1): (0, 1)}
    for less in (replace(seen, alone_bytes=909), replace(seen, tiles=(replace(large, passing=True),))):
        assert (FRAME + 4, 1) not in levels(create_rate_policy(policy).decide(less))


@pytest.mark.parametrize("policy", ["utility", "paper"])
def test_detail_goes_alone_only_where_it_does_not_take_the_link_for_long(policy: str) -> None:
    """Once 38 kB of a third level took a link of 0.44 Mbps for 20 frames, and the next chunk came after its time."""
    large = replace(CHUNK, depth=1, lod_bytes=(900, 950), weight=5_000.0)
    seen = Observation(FRAME, 500, (large,), (2.0, 2.0, 2.0), 10, alone_bytes=2_000, frame_bytes=96.0)
    assert levels(create_rate_policy(policy).decide(seen)) == {(CHUNK.frame, 1): (1, 2)}
    assert levels(create_rate_policy(policy).decide(replace(seen, frame_bytes=95.0))) == {}


def test_nothing_larger_than_the_budget_goes_beside_something_else() -> None:
    large = replace(CHUNK, frame=FRAME + 4, lod_bytes=(900, 950), weight=1.0)
    seen = Observation(FRAME, 500, (large, CHUNK), (2.0, 2.0, 2.0), 10, alone_bytes=2_000)
    assert levels(create_rate_policy("utility").decide(seen)) == {(18, 1): (0, 2)}
