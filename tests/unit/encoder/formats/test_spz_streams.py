"""SPZ version 4: its container of zstd streams."""

from pathlib import Path

import gsply
import numpy as np
import pytest
import zstandard

from cags_common.errors import SceneError
from cags_encoder.formats.spz import parse_spz, spz_bytes
from cags_encoder.formats.spz_header import SpzHeader
from cags_encoder.formats.spz_streams import ENTRY, HEADER
from support.splat_files import random_splats, spz4_bytes, spz_parts, spz_streams


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_it_holds_what_version_3_holds(degree: int) -> None:
    splats = random_splats(70, degree)
    three, four = parse_spz(spz_bytes(splats), "x"), parse_spz(spz4_bytes(splats), "x")
    for (name, a), (_, b) in zip(three.arrays(), four.arrays(), strict=True):
        assert np.array_equal(a, b), name


def test_a_file_of_gsply_is_read(tmp_path: Path) -> None:
    splats, path = random_splats(90, 2), tmp_path / "a.spz"
    theirs = gsply.GSData.from_arrays(
        splats.means, splats.log_scales, splats.quats, splats.logit_opacities, splats.sh0, splats.sh_rest
    )
    gsply.write_spz(str(path), theirs, version=4)
    ours, back = parse_spz(path.read_bytes(), "x"), gsply.read_spz(str(path))
    np.testing.assert_allclose(ours.means, back.means, atol=1e-5)
    np.testing.assert_allclose(ours.sh0, back.sh0, atol=1e-5)
    np.testing.assert_allclose(np.abs(np.sum(ours.quats * back.quats, axis=1)), 1, atol=1e-4)


def test_extensions_before_the_table_are_skipped() -> None:
    header, parts = spz_parts(random_splats(20, 1))
    assert len(parse_spz(spz_streams(header, parts, table=96), "x")) == 20


HEAD, PARTS = spz_parts(random_splats(20, 1))
WHOLE = spz_streams(HEAD, PARTS)


def with_entry(row: int, packed: int | None = None, size: int | None = None) -> bytes:
    at = HEADER.size + row * ENTRY.size
    before = ENTRY.unpack_from(WHOLE, at)
    entry = ENTRY.pack(before[0] if packed is None else packed, before[1] if size is None else size)
    return WHOLE[:at] + entry + WHOLE[at + ENTRY.size :]


@pytest.mark.parametrize(
    ("data", "word"),
    [
        (WHOLE[:20], "cut short in its header"),
        (WHOLE[:50], "table of streams"),
        (WHOLE[:-30], "is cut short"),
        (spz_streams(SpzHeader(4, 20, 0, 12), PARTS)[:13] + WHOLE[13:], "SH degree"),
        (with_entry(0, size=2**60), "claims 1152921504606846976 bytes"),
        (with_entry(1, packed=2**60), "takes 1152921504606846976 bytes"),
        (with_entry(0, packed=3), "zstd"),
        (spz_streams(HEAD, {**PARTS, "mean": bytes(9 * 19)}), "mean claims 171 bytes"),
    ],
)
def test_damage_is_named(data: bytes, word: str) -> None:
    with pytest.raises(SceneError, match=f"^x: .*{word}"):
        parse_spz(data, "x")


def test_a_stream_that_claims_a_gigabyte_is_not_inflated() -> None:
    bomb = zstandard.ZstdCompressor().compress(bytes(1 << 30))
    at = HEADER.size + 6 * ENTRY.size
    data = WHOLE[: HEADER.size] + ENTRY.pack(len(bomb), 180) + WHOLE[HEADER.size + ENTRY.size : at] + bomb
    with pytest.raises(SceneError, match="mean is packed for 1073741824 bytes, not 180"):
        parse_spz(data, "x")
