from typing import Any

import numpy as np
import pytest

from cags_common.video.colour import Chroma, planes_of_ycbcr, rgb_of_ycbcr, ycbcr_of_planes, ycbcr_of_rgb


def planes_of_rgb(rgb: np.ndarray[Any, Any], chroma: Chroma) -> np.ndarray[Any, Any]:
    return planes_of_ycbcr(ycbcr_of_rgb(rgb), chroma)


def rgb_of_planes(planes: np.ndarray[Any, Any], chroma: Chroma) -> np.ndarray[Any, Any]:
    return rgb_of_ycbcr(ycbcr_of_planes(planes, chroma))


def smooth_image(height: int = 30, width: int = 40) -> np.ndarray:
    y, x = np.mgrid[0:height, 0:width] / (height + width)
    return np.stack([x, y, 0.3 + 0.5 * x], axis=-1).astype(np.float32)


@pytest.mark.parametrize("chroma", list(Chroma))
def test_a_smooth_image_survives_the_round_trip_within_two_levels(chroma: Chroma) -> None:
    image = smooth_image()
    back = rgb_of_planes(planes_of_rgb(image, chroma), chroma)
    inner = (slice(2, -2), slice(2, -2))  # at the border half chroma has only one side to interpolate from
    assert np.abs(back - image)[inner].max() < 2.5 / 255


@pytest.mark.parametrize("chroma", list(Chroma))
def test_black_and_white_use_the_limited_range(chroma: Chroma) -> None:
    black, white = (planes_of_rgb(np.full((4, 6, 3), v, np.float32), chroma).reshape(-1) for v in (0.0, 1.0))
    assert set(black[:24]) == {16}
    assert set(white[:24]) == {235}
    assert set(black[24:]) == set(white[24:]) == {128}


def test_values_outside_the_unit_range_are_clipped() -> None:
    wild = np.array([[[-3.0, 0.5, 7.0]] * 2] * 2, np.float32)
    tame = np.clip(wild, 0, 1)
    assert np.array_equal(planes_of_rgb(wild, Chroma.FULL), planes_of_rgb(tame, Chroma.FULL))


def test_bytes_and_unit_floats_mean_the_same() -> None:
    image = (smooth_image() * 255).round().astype(np.uint8)
    as_float = image.astype(np.float32) / 255
    assert np.array_equal(planes_of_rgb(image, Chroma.HALF), planes_of_rgb(as_float, Chroma.HALF))


def test_primaries_match_the_matrix_of_bt709() -> None:
    """ITU-R BT.709: pure red has luma 0.2126 and Cr at the top of its range."""
    red = planes_of_rgb(np.array([[[1.0, 0.0, 0.0]]], np.float32), Chroma.FULL).reshape(3)
    assert red[0] == round(16 + 219 * 0.2126)
    assert red[2] == 240
