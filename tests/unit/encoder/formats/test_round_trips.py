"""Every importer reads a written file back, within the quantisation step of its format."""

from pathlib import Path

import gsply
import numpy as np
import pytest

from cags_common.geometry import F32
from cags_common.splats import SH_C0, Splats
from cags_common.tiles.morton import morton_order
from cags_encoder.formats import FORMATS, read_splats, write_splats
from cags_encoder.formats.compressed_ply import CHUNK, compressed_ply_bytes, parse_compressed_ply
from cags_encoder.formats.ply import parse_ply, ply_bytes
from cags_encoder.formats.sog import parse_sog_bytes
from cags_encoder.formats.sog_writer import sog_bytes
from cags_encoder.formats.splat import parse_splat, splat_bytes
from cags_encoder.formats.spz import parse_spz, spz_bytes
from support.splat_files import random_splats

DEGREES = (0, 1, 2, 3)
HALF_BYTE = 0.5 / 255 + 1e-6


def in_morton_order(splats: Splats) -> Splats:
    return splats.take(morton_order(splats.means))


def opacity(splats: Splats) -> F32:
    return 1 / (1 + np.exp(-splats.logit_opacities))


def angle_deg(a: Splats, b: Splats) -> float:
    cosine = np.abs(np.sum(a.quats.astype(np.float64) * b.quats, axis=1))
    return float(np.degrees(2 * np.arccos(np.minimum(cosine, 1)).max()))


@pytest.mark.parametrize("degree", DEGREES)
def test_ply_loses_nothing(degree: int) -> None:
    splats = random_splats(70, degree)
    back = parse_ply(ply_bytes(splats), "x")
    for (name, ours), (_, theirs) in zip(splats.arrays(), back.arrays(), strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-7, err_msg=name)


@pytest.mark.parametrize("degree", DEGREES)
@pytest.mark.parametrize("count", [1, CHUNK, CHUNK + 1, 700])
def test_compressed_ply_is_within_half_a_step(degree: int, count: int) -> None:
    splats = random_splats(count, degree)
    ordered, back = in_morton_order(splats), parse_compressed_ply(compressed_ply_bytes(splats), "x")
    for start in range(0, count, CHUNK):
        rows = slice(start, start + CHUNK)
        for name, steps in (("means", [2047, 1023, 2047]), ("log_scales", [2047, 1023, 2047]), ("sh0", [255] * 3)):
            ours, theirs = getattr(ordered, name)[rows], getattr(back, name)[rows]
            assert (np.abs(ours - theirs) <= 0.5 * np.ptp(ours, axis=0) / steps + 1e-5).all(), name
    assert np.abs(opacity(ordered) - opacity(back)).max() <= HALF_BYTE
    assert angle_deg(ordered, back) < 0.3
    assert np.abs(ordered.sh_rest - back.sh_rest).max(initial=0) <= 8 / 256


def test_splat_keeps_positions_and_eight_bits_of_the_rest() -> None:
    splats = random_splats(90, 0)
    back = parse_splat(splat_bytes(splats), "x")
    np.testing.assert_array_equal(splats.means, back.means)
    np.testing.assert_allclose(splats.log_scales, back.log_scales, atol=1e-6)
    rgb = np.clip(0.5 + SH_C0 * splats.sh0, 0, 1)
    np.testing.assert_allclose(rgb, 0.5 + SH_C0 * back.sh0, atol=HALF_BYTE)
    assert np.abs(opacity(splats) - opacity(back)).max() <= HALF_BYTE
    assert angle_deg(splats, back) < 1.2
    assert back.sh_degree == 0


@pytest.mark.parametrize("degree", DEGREES)
def test_spz_is_within_its_steps(degree: int) -> None:
    splats = random_splats(90, degree)
    back = parse_spz(spz_bytes(splats), "x")
    np.testing.assert_allclose(splats.means, back.means, atol=np.abs(splats.means).max() / 2**22)
    np.testing.assert_allclose(splats.log_scales, back.log_scales, atol=1 / 32 + 1e-6)
    np.testing.assert_allclose(splats.sh0, back.sh0, atol=HALF_BYTE / 0.15)
    np.testing.assert_allclose(splats.sh_rest, back.sh_rest, atol=1 / 256 + 1e-6)
    assert np.abs(opacity(splats) - opacity(back)).max() <= HALF_BYTE
    assert angle_deg(splats, back) < 0.4


@pytest.mark.parametrize("degree", DEGREES)
def test_sog_is_within_its_codebooks(degree: int) -> None:
    splats = random_splats(300, degree)
    ordered, back = in_morton_order(splats), parse_sog_bytes(sog_bytes(splats), "x")
    reach = np.abs(splats.means).max()
    assert np.abs(ordered.means - back.means).max() <= (1 + reach) * 2 * np.log1p(reach) / 65535
    for name in ("log_scales", "sh0", "sh_rest"):
        ours, theirs = getattr(ordered, name), getattr(back, name)
        if ours.size:
            assert np.abs(ours - theirs).max() <= np.ptp(ours) / 254, name
    assert np.abs(opacity(ordered) - opacity(back)).max() <= HALF_BYTE
    assert angle_deg(ordered, back) < 1.0


def test_sog_palette_that_overflows_uses_the_nearest_entries(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cags_encoder.formats.sog_writer.MAX_PALETTE", 128)
    splats = random_splats(400, 1)
    ordered, back = in_morton_order(splats), parse_sog_bytes(sog_bytes(splats), "x")
    error = np.square(ordered.sh_rest - back.sh_rest).mean()
    assert 0 < error < np.var(splats.sh_rest)


@pytest.mark.parametrize("name", FORMATS)
def test_writing_is_deterministic(name: str) -> None:
    splats = random_splats(100, 1)
    assert FORMATS[name].write(splats) == FORMATS[name].write(splats)


@pytest.mark.parametrize("name", FORMATS)
@pytest.mark.parametrize(
    "splats", [random_splats(1, 0), random_splats(40, 0).take(np.zeros(40, int))], ids=["one", "equal"]
)
def test_degenerate_sets_survive(name: str, splats: Splats) -> None:
    back = FORMATS[name].parse(FORMATS[name].write(splats), "x")
    assert len(back) == len(splats)
    np.testing.assert_allclose(back.means, splats.means, atol=1e-3)


@pytest.mark.parametrize("degree", DEGREES)
def test_gsply_reads_what_we_write_and_we_read_what_it_writes(degree: int, tmp_path: Path) -> None:
    splats = random_splats(300, degree, seed=degree)
    write_splats(tmp_path / "a.ply", splats)
    theirs = gsply.plyread(str(tmp_path / "a.ply"))
    np.testing.assert_array_equal(theirs.means, splats.means)
    np.testing.assert_array_equal(theirs.scales, splats.log_scales)
    if degree:
        np.testing.assert_array_equal(theirs.shN, splats.sh_rest)
    write_splats(tmp_path / "a.spz", splats)
    spz, ours = gsply.read_spz(tmp_path / "a.spz"), read_splats(tmp_path / "a.spz")[0]
    np.testing.assert_allclose(spz.means, ours.means, atol=1e-6)
    np.testing.assert_allclose(np.abs(np.sum(spz.quats * ours.quats, axis=1)), 1, atol=1e-5)
    np.testing.assert_allclose(spz.sh0, ours.sh0, atol=1e-6)
    write_splats(tmp_path / "a.compressed.ply", splats)
    packed, ours = gsply.plyread(str(tmp_path / "a.compressed.ply")), read_splats(tmp_path / "a.compressed.ply")[0]
    np.testing.assert_allclose(packed.means, ours.means, atol=1e-5)
    np.testing.assert_allclose(packed.sh0, ours.sh0, atol=1e-5)
    np.testing.assert_allclose(np.abs(np.sum(packed.quats * ours.quats, axis=1)), 1, atol=1e-5)
    gsply.plywrite(str(tmp_path / "b.ply"), theirs)
    np.testing.assert_array_equal(read_splats(tmp_path / "b.ply")[0].sh_rest, splats.sh_rest)
    gsply.write_spz(tmp_path / "b.spz", theirs, version=3)
    np.testing.assert_allclose(read_splats(tmp_path / "b.spz")[0].means, splats.means, atol=1 / 4096)
