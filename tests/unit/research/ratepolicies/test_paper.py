import pytest

from cags_common.errors import ConfigError
from cags_server.ratecontrol import Observation, TileView, create_rate_policy
from cags_server.ratecontrol.base import Decision

SIZES = (100, 10, 10, 10, 10)
OVERHEAD = 5


def tile(number: int, depth: int, visible: int, sizes: tuple[int, ...] = SIZES) -> TileView:
    return TileView(0, number, depth, visible, sizes)


def decide(budget: int, *tiles: TileView) -> Decision:
    return create_rate_policy("paper").decide(Observation(3, budget, tiles, (), OVERHEAD))


def depths(decision: Decision) -> dict[int, tuple[int, int]]:
    return {u.tile: (u.from_lod, u.to_lod) for u in decision.upgrades}


def test_step_3_raises_new_tiles_to_the_average_of_the_sent_ones() -> None:
    decision = decide(250, tile(0, 3, 50), tile(1, 3, 40), tile(2, 0, 9), tile(3, 0, 8))
    assert depths(decision) == {2: (0, 3), 3: (0, 3)}


def test_a_fractional_average_is_reached_by_the_mean_of_the_new_tiles() -> None:
    decision = decide(222, tile(0, 2, 50), tile(1, 1, 40), tile(2, 0, 9), tile(3, 0, 8))
    assert depths(decision) == {2: (0, 2), 3: (0, 1)}  # mean 1.5


def test_step_4_raises_sent_tiles_most_visible_first() -> None:
    decision = decide(60, tile(0, 1, 10), tile(1, 1, 50), tile(2, 1, 30))
    assert depths(decision) == {1: (1, 5), 2: (1, 2)}
    assert decision.bytes == 5 + 40 + 5 + 10


def test_new_tiles_come_before_better_ones() -> None:
    decision = decide(130, tile(0, 1, 99), tile(1, 0, 1))
    assert depths(decision) == {1: (0, 1), 0: (1, 3)}


def test_new_tiles_rise_together_within_the_budget() -> None:
    decision = decide(2 * 105 + 30, tile(0, 0, 5), tile(1, 0, 6))
    assert depths(decision) == {0: (0, 2), 1: (0, 3)}  # the more visible one takes the odd level


def test_with_nothing_sent_there_is_no_average_and_new_tiles_rise_to_the_top() -> None:
    assert depths(decide(10_000, tile(0, 0, 5), tile(1, 0, 6))) == {0: (0, 5), 1: (0, 5)}


def test_a_tile_too_large_for_the_budget_leaves_room_for_smaller_ones() -> None:
    huge = tile(0, 0, 90, (5000, 1))
    assert depths(decide(150, huge, tile(1, 0, 5))) == {1: (0, 5)}


def test_while_a_new_tile_waits_for_budget_nothing_is_spent_on_detail() -> None:
    """Else a base layer larger than one frame's budget would never be sent."""
    assert decide(90, tile(0, 0, 9), tile(1, 2, 50)).upgrades == ()


@pytest.mark.parametrize("budget", [0, 3, 104, 105, 500, 10_000])
def test_the_budget_is_never_exceeded(budget: int) -> None:
    tiles = [tile(i, i % 3, 100 - i) for i in range(20)]
    decision = decide(budget, *tiles)
    cost = sum(sum(SIZES[u.from_lod : u.to_lod]) + OVERHEAD for u in decision.upgrades)
    assert cost == decision.bytes <= budget


def test_nothing_visible_and_nothing_left_send_nothing() -> None:
    assert decide(1000).upgrades == ()
    assert decide(1000, tile(0, 5, 5)).upgrades == ()


def test_the_order_of_tiles_does_not_matter() -> None:
    tiles = [tile(i, i % 4, (i * 7) % 13) for i in range(12)]
    assert decide(400, *tiles) == decide(400, *reversed(tiles))


def test_an_unknown_policy_is_named() -> None:
    with pytest.raises(ConfigError, match="'greedy' is unknown"):
        create_rate_policy("greedy")


def test_where_lods_do_not_add_up_only_the_last_one_is_paid() -> None:
    whole = Observation(3, 165, (tile(0, 0, 5, (50, 90, 160, 300)),), (), OVERHEAD, layered=False)
    decision = create_rate_policy("paper").decide(whole)
    assert depths(decision) == {0: (0, 3)}
    assert decision.bytes == 165
    again = Observation(3, 300, (tile(0, 1, 5, (50, 90, 160, 300)),), (), OVERHEAD, layered=False)
    assert create_rate_policy("paper").decide(again).bytes == 165
