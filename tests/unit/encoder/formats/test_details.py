"""Special cases of single formats, as found in real files."""

import json
import struct

import numpy as np
import pytest

from cags_common.errors import SceneError
from cags_encoder.formats.compressed_ply import compressed_ply_bytes, parse_compressed_ply
from cags_encoder.formats.ply import parse_ply, ply_bytes
from cags_encoder.formats.ply_container import parse_header
from cags_encoder.formats.sog import parse_sog_bytes
from cags_encoder.formats.sog_writer import sog_bytes
from cags_encoder.formats.splat import RECORD, parse_splat
from cags_encoder.formats.spz import HEADER, parse_spz
from cags_encoder.formats.spz_header import MAGIC
from support.splat_files import gzipped, random_splats, zip_files, zip_of

SPLATS = random_splats(40, 1)


def test_ply_of_any_order_and_type_with_other_properties() -> None:
    """Double precision, big-endian, shuffled, with properties of other methods and a comment."""
    names = [name for name, _ in parse_header(ply_bytes(SPLATS), "x").elements[0].properties]
    table = dict(
        zip(names, np.frombuffer(ply_bytes(SPLATS)[-40 * 4 * len(names) :], "<f4").reshape(40, -1).T, strict=True)
    )
    shuffled = [*np.random.default_rng(0).permutation(names), "confidence"]
    rows = np.zeros(40, [(name, ">f8" if i % 2 else ">f4") for i, name in enumerate(shuffled)])
    for name in names:
        rows[name] = table[name]
    kinds = ("float", "double")
    lines = ["ply", "format binary_big_endian 1.0", "comment from elsewhere", "element vertex 40"]
    lines += [f"property {kinds[i % 2]} {name}" for i, name in enumerate(shuffled)]
    data = "\r\n".join([*lines, "end_header", ""]).encode() + rows.tobytes()
    np.testing.assert_array_equal(parse_ply(data, "x").sh_rest, SPLATS.sh_rest)


def text_ply(rows: list[str], names: str = "x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2") -> bytes:
    properties = [f"property double {name}" for name in [*names.split(), "rot_0", "rot_1", "rot_2", "rot_3"]]
    lines = ["ply", "format ascii 1.0", "element vertex 2", *properties, "element extra 1", "property int n"]
    return "\r\n".join([*lines, "end_header", *rows, "7", ""]).encode()


TEXT_ROWS = ["1 2 3 .1 .2 .3 -1.5 -4 -5 -6 1 0 0 0", "4e0 5 6 .4 .5 .6 2 -4 -5 -6 0 1 0 0"]


def test_ply_of_text_with_another_element_after_it() -> None:
    back = parse_ply(text_ply(TEXT_ROWS), "x")
    assert back.means.tolist() == [[1, 2, 3], [4, 5, 6]]
    assert back.logit_opacities.tolist() == [-1.5, 2]
    assert back.log_scales.tolist() == [[-4, -5, -6]] * 2
    assert back.quats.tolist() == [[1, 0, 0, 0], [0, 1, 0, 0]]


@pytest.mark.parametrize(
    ("rows", "word"),
    [
        (TEXT_ROWS[:1], "cut short"),
        ([TEXT_ROWS[0], TEXT_ROWS[1] + " 9"], "does not consist of rows of numbers"),
        ([TEXT_ROWS[0], TEXT_ROWS[1].replace("5", "five", 1)], "does not consist of rows of numbers"),
        ([TEXT_ROWS[0], TEXT_ROWS[1].replace("4e0", "nan")], r"means\[1\]"),
        ([], "cut short"),
        (["1 2", "3 4", "5 6", *["# " + 30 * "-"] * 2], "not 2 rows of 14 numbers"),
    ],
)
def test_ply_of_text_that_is_damaged(rows: list[str], word: str) -> None:
    with pytest.raises(SceneError, match=word):
        parse_ply(text_ply(rows), "file.ply")


def test_a_text_ply_that_claims_more_rows_than_its_bytes_can_hold_is_refused_before_allocation() -> None:
    with pytest.raises(SceneError, match="cut short"):
        parse_ply(text_ply(TEXT_ROWS).replace(b"vertex 2", b"vertex 19000000"), "file.ply")


@pytest.mark.parametrize(
    ("data", "word"), [(b"ply", "cut short"), (b"ply\r", "cut short"), (b"plyx", "is not a PLY file")]
)
def test_a_file_that_ends_in_its_first_line_is_cut_short(data: bytes, word: str) -> None:
    with pytest.raises(SceneError, match=word):
        parse_header(data, "file.ply")


def test_infinite_opacity_is_kept_as_opaque() -> None:
    arrays = {name: array.copy() for name, array in SPLATS.arrays()}
    arrays["logit_opacities"][:2] = np.inf, -np.inf
    back = parse_ply(ply_bytes(type(SPLATS)(**arrays)), "x")
    assert back.logit_opacities[:2].tolist() == [20.0, -20.0]


def test_splat_with_zero_scale_zero_rotation_and_full_opacity() -> None:
    rows = np.zeros(2, RECORD)
    rows["quat"] = 128
    rows["rgba"] = 255
    back = parse_splat(rows.tobytes(), "x")
    assert back.quats.tolist() == [[1, 0, 0, 0]] * 2
    assert np.isfinite(back.log_scales).all()
    assert (back.log_scales < -20).all()
    assert (back.logit_opacities > 10).all()


def test_compressed_ply_without_colour_bounds() -> None:
    """Files of early versions, in which colours span 0..1."""
    data = compressed_ply_bytes(random_splats(40, 0))
    header, body = data.split(b"end_header\n", 1)
    kept = b"".join(line + b"\n" for line in header.splitlines() if not line.endswith((b"_r", b"_g", b"_b")))
    back = parse_compressed_ply(kept + b"end_header\n" + body[: 12 * 4] + body[18 * 4 :], "x")
    assert np.abs(back.sh0).max() <= 0.5 / 0.28209 + 1e-4


@pytest.mark.parametrize("version", [1, 2])
def test_spz_of_older_versions(version: int) -> None:
    mean = np.array([0.5, -1.25, 3.0])
    position = (
        mean.astype("<f2").tobytes() if version == 1 else b"".join(struct.pack("<i", int(v * 4096))[:3] for v in mean)
    )
    body = position + bytes([128]) + bytes([127, 127, 127]) + bytes([80, 96, 112]) + bytes([255, 128, 128])
    back = parse_spz(gzipped(HEADER.pack(MAGIC, version, 1, 0, 12, 0, 0) + body), "x")
    np.testing.assert_allclose(back.means[0], mean)
    np.testing.assert_allclose(back.log_scales[0], [-5, -4, -3])
    np.testing.assert_allclose(back.quats[0], [0, 1, 0, 0], atol=0.01)


def test_sog_of_version_1() -> None:
    """The same images with linear ranges."""
    files = zip_files(sog_bytes(SPLATS))
    meta = json.loads(files["meta.json"])
    old = {
        "means": {"shape": [40, 3], "dtype": "float32", **meta["means"]},
        "scales": {"mins": [-9, -9, -9], "maxs": [0, 0, 0], "files": meta["scales"]["files"]},
        "quats": {"encoding": "quaternion_packed", **meta["quats"]},
        "sh0": {"mins": [-1, -1, -1, -6], "maxs": [1, 1, 1, 6], "files": meta["sh0"]["files"]},
        "shN": {"mins": -1.0, "maxs": 1.0, "files": meta["shN"]["files"]},
    }
    back = parse_sog_bytes(zip_of({**files, "meta.json": json.dumps(old).encode()}), "x")
    new = parse_sog_bytes(zip_of(files), "x")
    np.testing.assert_array_equal(back.means, new.means)
    np.testing.assert_array_equal(back.quats, new.quats)
    assert back.sh_rest.shape == (40, 3, 3)
    assert np.abs(back.sh_rest).max() <= 1
    assert -6 <= back.logit_opacities.min() <= back.logit_opacities.max() <= 6
    assert np.argmax(back.logit_opacities) == np.argmax(new.logit_opacities)


def test_sog_rotations_of_unknown_tag_are_the_identity() -> None:
    from io import BytesIO

    from PIL import Image

    files = zip_files(sog_bytes(SPLATS))
    pixels = np.asarray(Image.open(BytesIO(files["quats.webp"]))).copy()
    pixels[0, 0, 3] = 7
    out = BytesIO()
    Image.fromarray(pixels).save(out, "WEBP", lossless=True, exact=True)
    back = parse_sog_bytes(zip_of({**files, "quats.webp": out.getvalue()}), "x")
    assert back.quats[0].tolist() == [1, 0, 0, 0]
