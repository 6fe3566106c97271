"""Unreadable files are refused in one line that names the file and the fault."""

import struct
from pathlib import Path

import numpy as np
import pytest

from cags_common.errors import OutputError, SceneError
from cags_common.splats import MAX_SPLATS
from cags_encoder.formats import FORMATS, read_splats, write_splats
from cags_encoder.formats.compressed_ply import compressed_ply_bytes
from cags_encoder.formats.ply import ply_bytes
from cags_encoder.formats.sog_writer import sog_bytes
from cags_encoder.formats.spz import HEADER
from cags_encoder.formats.spz_header import MAGIC
from support.splat_files import gzipped, random_splats, with_meta, zip_files, zip_of

SPLATS = random_splats(40, 1)
PLY, COMPRESSED, SOG = ply_bytes(SPLATS), compressed_ply_bytes(SPLATS), sog_bytes(SPLATS)


def refuses(name: str, data: bytes, *words: str) -> str:
    with pytest.raises(SceneError) as caught:
        FORMATS[name].parse(data, "some/file")
    line = str(caught.value)
    assert "\n" not in line
    assert "some/file" in line
    for word in words:
        assert word in line
    return line


def spz_header(version: int = 3, count: int = 1, degree: int = 0, bits: int = 12, magic: int = MAGIC) -> bytes:
    return HEADER.pack(magic, version, count, degree, bits, 0, 0)


@pytest.mark.parametrize("name", FORMATS)
@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.9, 0.999])
def test_truncated_files(name: str, share: float) -> None:
    data = FORMATS[name].write(SPLATS)
    cut = int(share * len(data))
    refuses(name, data[: cut - cut % 32 + 7 if name == "splat" else cut])


@pytest.mark.parametrize("name", FORMATS)
def test_files_of_another_type(name: str) -> None:
    refuses(name, b"\x89PNG\r\n\x1a\n" + bytes(1001))


@pytest.mark.parametrize("suffix", [".ply", ".splat", ".spz", ".sog"])
def test_missing_empty_and_unreadable_files(suffix: str, tmp_path: Path) -> None:
    with pytest.raises(SceneError, match="cannot be read"):
        read_splats(tmp_path / f"none{suffix}")
    (tmp_path / f"empty{suffix}").write_bytes(b"")
    with pytest.raises(SceneError, match="is empty"):
        read_splats(tmp_path / f"empty{suffix}")


def test_unknown_suffixes_are_named_with_the_known_ones(tmp_path: Path) -> None:
    (tmp_path / "scene.glb").write_bytes(b"glTF")
    with pytest.raises(SceneError, match=r"'\.glb' is unknown; known: \.ply, \.sog, \.splat, \.spz"):
        read_splats(tmp_path / "scene.glb")
    with pytest.raises(SceneError, match=r"'\.obj' is unknown"):
        write_splats(tmp_path / "scene.obj", SPLATS)


def test_writing_where_one_cannot_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="cannot be written"):
        write_splats(tmp_path / "no" / "where.ply", SPLATS)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("attribute", ["means", "quats", "log_scales", "logit_opacities", "sh0", "sh_rest"])
def test_nan_is_named_by_attribute_and_row(attribute: str) -> None:
    arrays = {name: array.copy() for name, array in SPLATS.arrays()}
    arrays[attribute].reshape(40, -1)[7, 0] = np.nan
    refuses("ply", ply_bytes(type(SPLATS)(**arrays)), f"{attribute}[7]", "not finite")


@pytest.mark.parametrize(
    ("old", "new", "word"),
    [
        (b"format binary_little_endian", b"format binary_middle_endian", "'binary_middle_endian'"),
        (b"format binary_little_endian", b"format ascii", "does not consist of rows of numbers"),
        (b"element vertex 40", b"element vertex 0", "no splats"),
        (b"element vertex 40", b"element vertex 999999999999", str(MAX_SPLATS)),
        (b"element vertex 40", b"element vertex 41", "cut short"),
        (b"element vertex 40", b"element vertex -1", "element vertex -1"),
        (b"element vertex 40", b"element face 40", "no PLY element 'vertex'"),
        (b"property float opacity", b"property float opacitx", "'opacity'"),
        (b"property float opacity", b"property list uchar int opacity", "property list"),
        (b"property float opacity", b"property quad opacity", "property quad"),
        (b"property float x", b"property float y", "'y' appears twice"),
        (b"property float f_rest_8\n", b"", "8 f_rest properties"),
        (b"property float f_rest_8\n", b"property float f_rest_9\n", "'f_rest_8'"),
        (b"end_header", b"end_footer", "end_header"),
    ],
)
def test_ply_headers(old: bytes, new: bytes, word: str) -> None:
    assert old in PLY
    refuses("ply", PLY.replace(old, new, 1), word)


@pytest.mark.parametrize(
    ("old", "new", "word"),
    [
        (b"element chunk 1", b"element chunk 0", "0 chunks for 40 splats"),
        (b"element chunk 1", b"element block 1", "'chunk'"),
        (b"property float min_scale_x", b"property float min_scale_w", "'min_scale_x'"),
        (b"property uint packed_scale", b"property uint packed_scal", "'packed_scale'"),
        (b"element sh 40", b"element sh 39", "39 of 40"),
    ],
)
def test_compressed_ply_headers(old: bytes, new: bytes, word: str) -> None:
    assert old in COMPRESSED
    refuses("compressed-ply", COMPRESSED.replace(old, new, 1), word)


@pytest.mark.parametrize(
    ("data", "word"),
    [
        (spz_header(magic=1), "not SPZ"),
        (spz_header(version=0), "version 0"),
        (spz_header(version=9), "version 9"),
        (spz_header(degree=4), "SH degree 4"),
        (spz_header(bits=25), "25 fractional bits"),
        (spz_header(count=0), "no splats"),
        (spz_header(count=2**32 - 1), "4294967295"),
        (spz_header(count=1000) + bytes(100), "cut short"),
        (b"NGSP", "in its header"),
    ],
)
def test_spz_headers(data: bytes, word: str) -> None:
    refuses("spz", gzipped(data), word)


def test_spz_of_later_versions_is_named() -> None:
    refuses("spz", struct.pack("<II", MAGIC, 5) + bytes(40), "version 5", "save it as version 3")


@pytest.mark.parametrize(
    ("field", "value", "word"),
    [
        ("version", 3, "version 3"),
        ("version", "2", "version must be"),
        ("count", 0, "no splats"),
        ("count", 10**18, str(10**18)),
        ("count", 41, "40 pixels for 41 splats"),
        ("count", 40.0, "count must be"),
        ("means", None, "means.mins"),
        ("means.mins", [0, 0], "means.mins"),
        ("means.mins", [0, 0, 1e39], "means.mins"),
        ("means.maxs", [0, 0, "x"], "means.maxs"),
        ("means.maxs", [3e38, 3e38, 3e38], "means"),
        ("means.files", ["means_l.webp"], "means.files"),
        ("quats.files", ["../quats.webp"], "quats.files"),
        ("quats.files", ["/etc/passwd"], "quats.files"),
        ("quats.files", ["gone.webp"], "gone.webp"),
        ("quats.files", ["meta.json"], "not a readable image"),
        ("scales.codebook", [0.0] * 255, "scales.codebook"),
        ("scales.codebook", [0.0] * 255 + [None], "scales.codebook"),
        ("shN.bands", 4, "shN.bands"),
        ("shN.bands", 2, "palette"),
        ("shN.count", 65537, "shN.count"),
        ("shN.count", 3, "label"),
    ],
)
def test_sog_meta(field: str, value: object, word: str) -> None:
    refuses("sog", with_meta(SOG, **{field: value}), word)


def test_sog_meta_that_is_no_json_or_no_object() -> None:
    files = zip_files(SOG)
    refuses("sog", zip_of({**files, "meta.json": b"{"}), "not JSON")
    refuses("sog", zip_of({**files, "meta.json": b"[1]"}), "must be an object")
    refuses("sog", zip_of({**files, "meta.json": b"[" * 100_000}), "not JSON")
    files.pop("meta.json")
    refuses("sog", zip_of(files), "lacks meta.json")


def test_sog_images_too_large_for_the_count_are_refused_before_they_are_decoded() -> None:
    huge = zip_files(sog_bytes(random_splats(90_000, 0)))["quats.webp"]
    refuses("sog", zip_of({**zip_files(SOG), "quats.webp": huge}), "too large")


def test_a_zip_of_many_files_is_no_bundle() -> None:
    refuses("sog", zip_of({f"{i}.txt": b"" for i in range(70)}), "over 64 files")


def test_deflate_bombs_stop_at_their_bound() -> None:
    refuses("spz", gzipped(spz_header(count=1_000_000) + bytes(1 << 20)), "cut short")
    refuses("spz", gzipped(spz_header(count=20_000_000) + bytes(1 << 20)), "too few for that many")


def write_unbundled(folder: Path, sog: bytes) -> None:
    for name, content in zip_files(sog).items():
        (folder / name).write_bytes(content)


def test_unbundled_sog_equals_bundled(tmp_path: Path) -> None:
    write_unbundled(tmp_path, SOG)
    for path in (tmp_path, tmp_path / "meta.json"):
        splats, entry = read_splats(path)
        assert entry.name == "sog"
        np.testing.assert_array_equal(splats.sh_rest, FORMATS["sog"].parse(SOG, "x").sh_rest)
    (tmp_path / "sh0.webp").unlink()
    with pytest.raises(SceneError, match=r"sh0\.webp: cannot be read"):
        read_splats(tmp_path)
