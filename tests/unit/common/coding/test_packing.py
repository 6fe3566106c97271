import gzip

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cags_common.coding.packing import (
    check_crc,
    crc32,
    decode_ids,
    encode_ids,
    gunzip_bounded,
    gzip_bytes,
    gzip_planes,
    squeeze,
    unsqueeze,
)
from cags_common.errors import DecodeError


def test_gzip_holds_no_time_and_is_ordinary_gzip() -> None:
    assert gzip_bytes(b"abc" * 100) == gzip_bytes(b"abc" * 100)
    assert gzip.decompress(gzip_bytes(b"abc")) == b"abc"


def test_gunzip_stops_at_its_limit_and_refuses_damage() -> None:
    data = gzip_bytes(bytes(10_000))
    assert gunzip_bounded(data, 10_000, "x") == bytes(10_000)
    with pytest.raises(DecodeError, match="more than 9999 bytes"):
        gunzip_bounded(data, 9_999, "x")
    for bad in (data[:-1], data + b"!", b"", b"nonsense"):
        with pytest.raises(DecodeError):
            gunzip_bounded(bad, 10_000, "x")


@given(st.lists(st.one_of(st.binary(max_size=300), st.integers(0, 300).map(bytes)), max_size=6))
def test_planes_come_back_as_ordinary_gzip(planes: list[bytes]) -> None:
    data = gzip_planes([memoryview(plane) for plane in planes], 1)
    assert gzip.decompress(data) == gunzip_bounded(data, 2000, "x") == b"".join(planes)
    assert data == gzip_planes([memoryview(plane) for plane in planes], 1)


def test_planes_that_do_not_shrink_are_stored() -> None:
    noise, zeros = np.random.default_rng(0).bytes(50_000), bytes(50_000)
    data = gzip_planes([memoryview(noise), memoryview(zeros)], 1)
    assert noise in data
    assert len(data) < 50_500


def test_unsqueeze_takes_back_what_squeeze_made_and_nothing_else() -> None:
    data = bytes(1000)
    small = squeeze(data)
    assert unsqueeze(small, 1000, "x") == data
    assert unsqueeze(squeeze(b"\x01\xfe"), 2, "x") == b"\x01\xfe", "what deflate makes longer stays as it is"
    for bad in (small[:-1], small + b"!", small[:-1] + b"\xff", b""):
        with pytest.raises(DecodeError, match="x: "):
            unsqueeze(bad, 1000, "x")
    for size in (999, 1001):
        with pytest.raises(DecodeError, match=f"other than its {size} bytes"):
            unsqueeze(small, size, "x")
    with pytest.raises(DecodeError, match="takes 1000 bytes, at most 10"):
        unsqueeze(data, 10, "x")


def test_crc_names_what_is_damaged() -> None:
    check_crc(b"abc", crc32(b"abc"), "tile 3")
    with pytest.raises(DecodeError, match="tile 3"):
        check_crc(b"abd", crc32(b"abc"), "tile 3")


@pytest.mark.parametrize("ids", [[], [0], [5], [0, 1, 2, 3], [3, 70_000, 70_001, 19_999_999]])
def test_ids_come_back(ids: list[int]) -> None:
    given = np.array(ids, np.int32)
    assert np.array_equal(decode_ids(encode_ids(given)), given)
    assert decode_ids(encode_ids(given)).dtype == np.int32


def test_another_number_of_ids_than_expected_is_refused_before_anything_is_inflated(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    many = encode_ids(np.arange(10_000, dtype=np.int32))
    assert len(decode_ids(many, expected=10_000)) == 10_000
    monkeypatch.setattr("cags_common.coding.packing.gunzip_bounded", None)
    with pytest.raises(DecodeError, match="tile ids: claims 10000 ids for 5 splats"):
        decode_ids(many, what="tile ids", expected=5)
    with pytest.raises(DecodeError, match="claims 0 ids for 5 splats"):
        decode_ids(b"", expected=5)


def test_ids_beyond_the_limit_are_refused() -> None:
    with pytest.raises(DecodeError, match="not below 100"):
        decode_ids(encode_ids(np.array([1, 100], np.int32)), limit=100)
    with pytest.raises(DecodeError, match="at most 2 ids"):
        decode_ids(encode_ids(np.array([0, 1, 2], np.int32)), limit=2)
