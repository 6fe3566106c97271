"""A Draco cloud from outside is checked before Draco allocates for it."""

from __future__ import annotations

import struct

import DracoPy
import numpy as np
import pytest

from cags_common.coding.draco import decode_points
from cags_common.errors import DecodeError

POINTS = np.random.default_rng(1).integers(0, 255, (20, 3)).astype(np.float32)
CLOUD = DracoPy.encode(POINTS, quantization_bits=8)


def test_a_cloud_comes_back() -> None:
    cloud, attributes = decode_points(CLOUD, 20)
    assert len(cloud.points) == 20
    assert attributes == {}
    assert np.abs(np.sort(cloud.points, axis=0) - np.sort(POINTS, axis=0)).max() < 1.5


@pytest.mark.parametrize("count", [0, 19, 21, 2**31 - 1])
def test_another_count_is_refused(count: int) -> None:
    with pytest.raises(DecodeError, match=f"point cloud of {count} points"):
        decode_points(CLOUD, count)


def test_a_header_that_claims_more_is_refused_unread() -> None:
    claims = CLOUD[:11] + struct.pack("<I", 2**31 - 1) + CLOUD[15:]
    with pytest.raises(DecodeError):
        decode_points(claims, 20)


@pytest.mark.parametrize("length", [0, 1, 14, 16, 30])
def test_a_cut_cloud_is_refused(length: int) -> None:
    with pytest.raises(DecodeError):
        decode_points(CLOUD[:length], 20)
