import numpy as np
import pytest

from cags_common.tiles.morton import morton_codes, morton_order, tile_ranges


def interleaved(x: int, y: int, z: int) -> int:
    return sum(
        ((x >> b) & 1) << (3 * b) | ((y >> b) & 1) << (3 * b + 1) | ((z >> b) & 1) << (3 * b + 2) for b in range(21)
    )


def test_codes_interleave_the_bits_of_the_axes() -> None:
    top = 2**21 - 1
    points = np.array(
        [[0, 0, 0], [top, top, top], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1_234_567, 89, 2_000_001]], np.float32
    )
    assert morton_codes(points).tolist() == [interleaved(*map(int, p)) for p in points]


def test_zero_extent_keeps_the_given_order() -> None:
    assert morton_order(np.full((5, 3), 7.0, np.float32)).tolist() == [0, 1, 2, 3, 4]
    assert morton_codes(np.zeros((0, 3), np.float32)).tolist() == []


@pytest.mark.parametrize(
    ("count", "largest", "sizes"),
    [
        (0, 10, []),
        (1, 10, [1]),
        (10, 10, [10]),
        (11, 10, [5, 6]),
        (20, 10, [10, 10]),
        (21, 10, [7, 7, 7]),
    ],
)
def test_tiles_are_as_few_and_as_equal_as_can_be(count: int, largest: int, sizes: list[int]) -> None:
    ranges = tile_ranges(count, largest)
    assert [end - first for first, end in ranges] == sizes
    assert [first for first, _ in ranges] == [0, *[end for _, end in ranges]][: len(ranges)]
