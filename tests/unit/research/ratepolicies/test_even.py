"""One level a frame: the highest that the budget brings every visible tile to."""

from cags_server.ratecontrol import Observation, TileView, create_rate_policy

SIZES = (100, 10, 10, 10)
OVERHEAD = 5


def depths(budget: int, *tiles: TileView) -> dict[int, tuple[int, int]]:
    decision = create_rate_policy("even").decide(Observation(3, budget, tiles, (), OVERHEAD))
    assert decision.bytes <= budget
    return {u.tile: (u.from_lod, u.to_lod) for u in decision.upgrades}


def tile(number: int, depth: int, visible: int, sizes: tuple[int, ...] = SIZES) -> TileView:
    return TileView(0, number, depth, visible, sizes)


def test_all_tiles_rise_to_one_level_and_what_is_left_is_kept() -> None:
    three = [tile(k, 0, 10 * k) for k in range(3)]
    assert depths(3 * 125, *three) == dict.fromkeys(range(3), (0, 3))
    assert depths(3 * 125 + 10, *three) == dict.fromkeys(range(3), (0, 3)), "room for one more tile's layer is left"


def test_tiles_that_have_less_catch_up_first() -> None:
    assert depths(25, tile(0, 3, 50), tile(1, 1, 1)) == {1: (1, 3)}


def test_a_tile_of_fewer_levels_does_not_hold_the_others_back() -> None:
    assert depths(1000, tile(0, 0, 1, (100,)), tile(1, 0, 1)) == {0: (0, 1), 1: (0, 4)}


def test_where_not_even_the_base_fits_the_most_visible_come_first() -> None:
    assert depths(210, *(tile(k, 0, 10 * k) for k in range(3))) == {2: (0, 1), 1: (0, 1)}
    assert depths(50, tile(0, 0, 1)) == {}
    assert depths(50) == {}
