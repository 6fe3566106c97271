"""The table of measured quality: back and forth, and refused where it is damaged."""

from __future__ import annotations

import pytest

from cags_common.bundle.quality import LayerQuality, LevelQuality, LodQuality
from cags_common.errors import BundleError

TABLE = LodQuality((LayerQuality("sh0", 1, 1200, 31.5, 0.93),), (LevelQuality(0, 9000, 26.0, 0.8),))


def test_it_comes_back_and_equal_tables_give_equal_bytes() -> None:
    data = TABLE.to_json()
    assert LodQuality.from_json(data) == TABLE
    assert LodQuality.from_json(data).to_json() == data


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"[]",
        b"{}",
        b"\xff" * 5000,
        b'{"layers":[{}],"ladder":[]}',
        TABLE.to_json()[:-1],
        b'{"layers":1,"ladder":[]}',
    ],
)
def test_damage_is_a_bundle_error(data: bytes) -> None:
    with pytest.raises(BundleError, match="encode the bundle again") as refused:
        LodQuality.from_json(data)
    assert len(str(refused.value)) < 300, "it does not quote the file"
