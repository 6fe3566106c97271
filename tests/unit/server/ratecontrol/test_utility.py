from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cags_server.ratecontrol import RATE_POLICIES, Decision, Observation, TileView, create_rate_policy
from cags_server.ratecontrol.outlook import lacking_bytes

SIZES = (100, 10, 10, 10, 10)


def tile(number: int, depth: int = 1, **how: float) -> TileView:
    return TileView(0, number, depth, int(how.pop("visible", 10)), SIZES, **how)


def decide(policy: str, budget: int, *tiles: TileView, gains: tuple[float, ...] = (), waiting_us: int = 0) -> Decision:
    return create_rate_policy(policy).decide(Observation(3, budget, tiles, gains, 5, waiting_us))


def reached(decision: Decision) -> dict[int, int]:
    return {u.tile: u.to_lod for u in decision.upgrades}


def test_the_larger_part_of_the_picture_is_refined_first() -> None:
    assert reached(decide("utility", 16, tile(0, weight=1.0), tile(1, weight=5.0))) == {1: 2}


def test_what_stays_is_refined_before_what_is_replaced_at_once() -> None:
    assert reached(decide("utility", 16, tile(0, frames_left=1.0), tile(1, frames_left=30.0))) == {1: 2}


def test_a_hole_is_filled_before_detail_is_added() -> None:
    assert reached(decide("utility", 110, tile(0, depth=0), tile(1))) == {0: 1}


def test_levels_lighter_than_a_message_come_with_the_base_if_they_fit() -> None:
    """Once splats stood at their lowest level for a frame, at 40 dB between 60 and 60, for want of 90 bytes."""

    def together(budget: int, overhead: int) -> list[tuple[int, int]]:
        new = tile(0, depth=0, replaces=True, weight=1e-3)
        decided = create_rate_policy("utility").decide(Observation(3, budget, (new,), (), overhead))
        return [(u.together, u.to_lod) for u in decided.upgrades]

    assert together(10_000, 25) == [(3, 5)], "two further levels are 20 bytes"
    assert together(10_000, 5) == [(1, 5)]
    assert together(130, 25) == [(1, 1)], "the base alone"


def test_measured_gains_decide_between_layers() -> None:
    gains = (0.01, 3.0, 0.01, 0.01)
    assert reached(decide("utility", 16, tile(0, depth=1), tile(1, depth=2), gains=gains)) == {1: 3}


def test_everything_is_sent_when_it_fits() -> None:
    assert reached(decide("utility", 10_000, tile(0, depth=0), tile(1, depth=3))) == {0: 5, 1: 5}


def test_budget_is_saved_for_a_base_layer_that_is_worth_more_than_detail() -> None:
    assert decide("utility", 60, tile(0, depth=0, weight=100.0), tile(1)).upgrades == ()
    assert reached(decide("utility", 60, tile(0, depth=0, weight=0.001), tile(1))) == {1: 5}


@pytest.mark.parametrize("policy", ["paper", "utility"])
def test_what_has_been_stale_for_longest_comes_first(policy: str) -> None:
    """Where everything moves and the link carries half of it, the same half would else be chosen in every frame."""
    stale, moved = (
        tile(i, depth=0, replaces=True, visible=v, weight=v, stale_frames=f) for i, v, f in [(0, 9, 3), (1, 10, 1)]
    )
    assert reached(decide(policy, 105, stale, moved)) == {0: 1}


def test_the_squared_error_of_what_is_stale_grows_with_its_age() -> None:
    """Four times a base layer's at one frame and eight at two: a new base layer removes 3 and 7."""
    older = tile(0, depth=0, replaces=True, weight=1.0, stale_frames=2.0, frames_left=1.0)
    wider = tile(1, depth=0, replaces=True, weight=2.2, stale_frames=1.0, frames_left=1.0)
    assert reached(decide("utility", 105, older, wider)) == {0: 1}
    assert reached(decide("utility", 105, older, replace(wider, weight=2.5))) == {1: 1}


def test_two_halves_that_always_move_take_turns() -> None:
    ages, chosen = [1.0, 1.0], []
    for _ in range(8):
        halves = (tile(i, depth=0, replaces=True, weight=1.0 + i, stale_frames=ages[i]) for i in (0, 1))
        (sent,) = reached(decide("utility", 105, *halves))
        ages = [1.0 if i == sent else ages[i] + 1 for i in (0, 1)]
        chosen.append(sent)
    assert chosen == [1, 0] * 4


def test_what_is_stale_is_no_worse_than_a_hole() -> None:
    """25 frames old it is as bad as nothing at all, and 1,000 frames old no worse."""
    hole = tile(0, depth=0, weight=1.0)
    for frames, weight, first in ((25.0, 1.01, 1), (1000.0, 1.01, 1), (1000.0, 0.99, 0)):
        stale = tile(1, depth=0, replaces=True, weight=weight, stale_frames=frames, frames_left=hole.frames_left)
        assert reached(decide("utility", 105, hole, stale)) == {first: 1}


def test_what_stays_may_come_late_and_what_passes_may_not() -> None:
    """Once a base layer of little worth was sent because detail of more worth was not in time, which it need not be."""
    stays, passes = tile(0, weight=9.0, frames_left=60.0), tile(1, weight=1.0, frames_left=1.0, passing=True)
    seen = Observation(3, 10_000, (stays, passes), (), 5, timely_bytes=26)
    decision = create_rate_policy("utility").decide(seen)
    assert reached(decision) == {0: 5, 1: 3}
    assert {u.tile: u.urgent for u in decision.upgrades} == {0: False, 1: True}
    assert reached(create_rate_policy("utility").decide(replace(seen, timely_bytes=0))) == {0: 5}


@pytest.mark.parametrize(("waiting_ms", "depth"), [(0, 5), (60, 5), (180, 2), (300, 1), (5000, 1)])
def test_the_buffer_policy_goes_by_waiting_time_alone(waiting_ms: int, depth: int) -> None:
    assert reached(decide("buffer", 0, tile(0, depth=0), waiting_us=waiting_ms * 1000)) == {0: depth}


def test_the_buffer_policy_never_takes_back_what_was_sent() -> None:
    assert decide("buffer", 0, tile(0, depth=4), waiting_us=1_000_000).upgrades == ()


@st.composite
def observations(draw: st.DrawFn) -> Observation:
    tiles = []
    for number in range(draw(st.integers(0, 12))):
        sizes = tuple(draw(st.lists(st.integers(0, 400), min_size=1, max_size=6)))
        depth = draw(st.integers(0, len(sizes)))
        weight, left = draw(st.floats(0, 1e5)), draw(st.floats(0, 60))
        tiles.append(
            TileView(
                draw(st.integers(0, 3)),
                number,
                depth,
                draw(st.integers(1, 5000)),
                sizes,
                weight,
                left,
                passing=draw(st.booleans()),
                replaces=draw(st.booleans()),
                stale_frames=draw(st.floats(1, 1e4)),
            )
        )
    gains = tuple(draw(st.lists(st.floats(-1, 5), max_size=6)))
    bytes_ = st.integers(0, 3000)
    layered = draw(st.booleans())
    return Observation(3, draw(bytes_), tuple(tiles), gains, 5, layered=layered, timely_bytes=draw(bytes_))


@pytest.mark.parametrize("name", RATE_POLICIES.names())
@given(observations())
def test_decisions_are_sound(name: str, observation: Observation) -> None:
    """Each tile rises at most once, from where it is, within its layers, and (but for ``buffer``) within bounds."""
    decision = create_rate_policy(name).decide(observation)
    tiles = {(t.frame, t.tile): t for t in observation.tiles}
    assert len({(u.frame, u.tile) for u in decision.upgrades}) == len(decision.upgrades)
    cost = urgent = 0
    for u in decision.upgrades:
        view = tiles[u.frame, u.tile]
        assert view.depth == u.from_lod < u.to_lod <= view.max_depth
        assert u.urgent == (view.passing and name != "buffer"), "what nothing bounds goes ahead of nothing"
        sent = view.lod_bytes[u.from_lod if observation.layered else u.to_lod - 1 : u.to_lod]
        cost += sum(sent) + 5
        new_bytes = sum(sent[: None if u.urgent or not observation.layered else 1]) + 5
        urgent += new_bytes if u.urgent or not u.from_lod else 0
    assert cost == decision.bytes
    assert name == "buffer" or cost <= observation.budget_bytes
    assert name == "buffer" or urgent <= observation.timely_bytes
    assert create_rate_policy(name).decide(observation) == decision


def test_what_is_lacking_is_what_brings_every_tile_near_its_best() -> None:
    gains = (10.0, 10.0, 0.1, 0.1)
    observed = Observation(3, 0, (tile(0, depth=1), tile(1, depth=0)), gains, 5)
    assert lacking_bytes(observed) == (10 + 10) + (100 + 10 + 10)
    assert lacking_bytes(replace(observed, tiles=(tile(0, depth=5), tile(1, depth=4)))) == 0


def test_what_begins_later_is_lacking_the_less() -> None:
    now, later = (replace(tile(0, depth=0), frame=frame) for frame in (3, 8))
    every = [lacking_bytes(Observation(3, 0, (each,), (), 5)) for each in (now, later, replace(later, frame=300))]
    assert every[0] > every[1] > every[2] == 0
