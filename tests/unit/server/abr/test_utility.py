import pytest
from hypothesis import given
from hypothesis import strategies as st

from cags_server.abr import RATE_POLICIES, Decision, Observation, TileView, create_rate_policy

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


def test_measured_gains_decide_between_layers() -> None:
    gains = (0.01, 3.0, 0.01, 0.01)
    assert reached(decide("utility", 16, tile(0, depth=1), tile(1, depth=2), gains=gains)) == {1: 3}


def test_everything_is_sent_when_it_fits() -> None:
    assert reached(decide("utility", 10_000, tile(0, depth=0), tile(1, depth=3))) == {0: 5, 1: 5}


def test_budget_is_saved_for_a_base_layer_that_is_worth_more_than_detail() -> None:
    assert decide("utility", 60, tile(0, depth=0, weight=100.0), tile(1)).upgrades == ()
    assert reached(decide("utility", 60, tile(0, depth=0, weight=0.001), tile(1))) == {1: 5}


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
        tiles.append(TileView(draw(st.integers(0, 3)), number, depth, draw(st.integers(1, 5000)), sizes, weight, left))
    gains = tuple(draw(st.lists(st.floats(-1, 5), max_size=6)))
    return Observation(3, draw(st.integers(0, 3000)), tuple(tiles), gains, 5)


@pytest.mark.parametrize("name", list(RATE_POLICIES))
@given(observations())
def test_decisions_are_sound(name: str, observation: Observation) -> None:
    """Each tile rises at most once, from where it is, within its layers, and (but for ``buffer``) within the budget."""
    decision = create_rate_policy(name).decide(observation)
    tiles = {(t.frame, t.tile): t for t in observation.tiles}
    assert len({(u.frame, u.tile) for u in decision.upgrades}) == len(decision.upgrades)
    cost = 0
    for u in decision.upgrades:
        view = tiles[u.frame, u.tile]
        assert view.depth == u.from_lod < u.to_lod <= view.max_depth
        cost += sum(view.lod_bytes[u.from_lod : u.to_lod]) + 5
    assert cost == decision.bytes
    assert name == "buffer" or cost <= observation.budget_bytes
    assert create_rate_policy(name).decide(observation) == decision
