"""Archives of arrays from outside: exact where they are whole, one line where they are not."""

import io
import zipfile

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays_of

from cags_common.errors import DecodeError
from cags_common.npz import MAX_ARRAYS, load_npz, read_npz

NAMES = st.text("abcdefgh.", min_size=1, max_size=8).filter(lambda name: not name.endswith(".npy"))
TYPES = st.sampled_from([np.uint8, np.int32, np.float32, np.float64])
ARRAYS = st.dictionaries(
    NAMES, TYPES.flatmap(lambda kind: arrays_of.arrays(kind, arrays_of.array_shapes())), max_size=4
)


def packed(**arrays: np.ndarray) -> bytes:
    out = io.BytesIO()
    np.savez_compressed(out, **arrays)
    return out.getvalue()


@given(ARRAYS)
def test_what_numpy_writes_comes_back(arrays: dict[str, np.ndarray]) -> None:
    back = read_npz(packed(**arrays), 1 << 20)
    assert back.keys() == arrays.keys()
    for name, array in arrays.items():
        assert back[name].dtype == array.dtype
        np.testing.assert_array_equal(back[name], array)


def test_columns_first_is_kept_in_meaning() -> None:
    array = np.asfortranarray(np.arange(6.0).reshape(2, 3))
    np.testing.assert_array_equal(read_npz(packed(a=array), 1 << 20)["a"], array)


@given(st.data())
def test_damage_is_told_and_never_anything_else(data: st.DataObject) -> None:
    whole = bytearray(packed(a=np.arange(40, dtype=np.float32), b=np.ones((2, 3))))
    for at, value in data.draw(st.lists(st.tuples(st.integers(0, len(whole) - 1), st.integers(0, 255)), min_size=1)):
        whole[at] = value
    try:
        read_npz(bytes(whole), 1 << 20)
    except DecodeError as error:
        assert "\n" not in str(error)


def test_bounds_hold_before_anything_is_unpacked() -> None:
    with pytest.raises(DecodeError, match="too much"):
        read_npz(packed(a=np.zeros(10_000)), 1000)
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        for number in range(MAX_ARRAYS + 1):
            archive.writestr(f"{number}.npy", b"")
    with pytest.raises(DecodeError, match="too much"):
        read_npz(out.getvalue(), 1 << 20)


def test_pickles_are_refused() -> None:
    with pytest.raises(DecodeError, match="type object"):
        read_npz(packed(a=np.array([{}], dtype=object)), 1 << 20)


def test_a_file_larger_than_its_bound_is_not_read_whole(tmp_path) -> None:
    (tmp_path / "large.npz").write_bytes(bytes(2000))
    with pytest.raises(DecodeError, match="larger than 1000 bytes"):
        load_npz(tmp_path / "large.npz", 1000)
