"""What prediction from frame to frame would save V3-A."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cags_common.splats import Ids, Splats
from cags_research.codecs.encoding.inter import saving
from cags_research.codecs.planes import decode_planes, encode_plane_video, encode_planes
from support.splat_files import random_splats


class Scene:
    """Frames that are given, whose rows are the same splats."""

    def __init__(self, frames: list[Splats]) -> None:
        self._frames = frames

    def __len__(self) -> int:
        return len(self._frames)

    def frame(self, index: int) -> Splats:
        return self._frames[index]

    def ids(self, index: int) -> Ids:
        return np.arange(len(self._frames[index]), dtype=np.int32)


def moved(splats: Splats, by: float) -> Splats:
    return replace(splats, means=splats.means + np.float32(by))


def test_the_first_unit_of_a_video_is_the_picture_that_is_sent_alone() -> None:
    values = np.random.default_rng(0).integers(0, 255, (300, 4)).astype(np.uint8)
    first, second = encode_plane_video([values, values], 20)
    assert first == encode_planes(values, 20)
    assert len(second) < len(first) / 10, "nothing has changed"
    np.testing.assert_array_equal(decode_planes(encode_planes(values, 0), 300, 4), values)


def test_a_tile_pays_for_nothing_that_a_decoder_does_not_need() -> None:
    """Each tile of V3-A, at each quality, brought 600 bytes in which x264 says who it is."""
    assert len(encode_planes(np.zeros((300, 4), np.uint8), 20)) < 100


def test_splats_that_only_move_are_worth_predicting() -> None:
    first = random_splats(400, 0)
    assert saving(Scene([moved(first, 0.001 * k) for k in range(4)])) > 1.5  # type: ignore[arg-type]


def test_splats_that_have_nothing_in_common_are_not() -> None:
    found = saving(Scene([random_splats(400, 0, seed) for seed in range(4)]))  # type: ignore[arg-type]
    assert 1.0 <= found < 1.5, "what is left is another way to write positions"


@pytest.mark.parametrize("frames", [1, 4])
def test_nothing_is_saved_where_nothing_changes(frames: int) -> None:
    assert saving(Scene([random_splats(400, 0)] * frames)) == 1.0  # type: ignore[arg-type]
