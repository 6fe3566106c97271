import json
from dataclasses import replace

import pytest

from cags_common.bundle import LodLayer, Manifest
from cags_common.bundle.manifest import MAX_WHOLE_SPLATS, FileEntry, GofFiles
from cags_common.bundle.tracks import ChangedShares, TrackStatistics
from cags_common.errors import BundleError
from cags_common.tiles.lod import MAX_LODS
from cags_protocol.wire.encoding import decode, encode
from cags_protocol.wire.messages import TileLayers

FILE = FileEntry("gof_0000.bin", 8, 123, 20)
MANIFEST = Manifest(
    name="clip",
    fps=29.97,
    frames=5,
    gof_starts=(0, 3),
    capacity=(10, 12),
    sh_degree=1,
    bounds=((-1.0, -2.0, -3.0), (1.0, 2.0, 3.0)),
    lod_order=(LodLayer("scale", 1), LodLayer("sh0", 1)),
    lod_gains_db=(3.5, -0.1),
    base_psnr_db=24.5,
    still_psnr_db=((1, 41.0), (4, 33.25)),
    outdated_psnr_db=((1, 38.0), (2, 30.5)),
    codec="svq",
    quantiser="paper-66",
    tracks=TrackStatistics(5, 20, 0.8, 2.5, (8, 4), ChangedShares(0.5, 0.0, 0.0, 0.9, 0.1, 0.0)),
    gofs=(GofFiles(FILE, FILE), GofFiles(FILE, FILE)),
)
TRACKS = json.loads(MANIFEST.to_json())["tracks"]


def changed(**fields: object) -> bytes:
    return json.dumps({**json.loads(MANIFEST.to_json()), **fields}).encode()


def test_a_manifest_comes_back_and_its_public_part_says_nothing_of_files() -> None:
    assert Manifest.from_json(MANIFEST.to_json()) == MANIFEST
    assert Manifest.from_json(MANIFEST.public_json()) == replace(MANIFEST, gofs=())
    assert b"gof_0000" not in MANIFEST.public_json()


def test_what_is_optional_may_be_absent() -> None:
    bare = replace(MANIFEST, tracks=None, base_psnr_db=None, still_psnr_db=(), outdated_psnr_db=())
    names = (b"tracks", b"base_psnr_db", b"still_psnr_db", b"outdated_psnr_db")
    assert not any(name in bare.to_json() for name in names)
    assert Manifest.from_json(bare.to_json()) == bare


def test_frames_know_their_group() -> None:
    assert [MANIFEST.gof_of(frame) for frame in range(5)] == [0, 0, 0, 1, 1]
    assert list(MANIFEST.gof_frames(1)) == [3, 4]
    with pytest.raises(BundleError, match="frame 5 is outside"):
        MANIFEST.gof_of(5)


def test_a_small_clip_is_kept_whole_and_so_is_one_of_a_single_group() -> None:
    half = MAX_WHOLE_SPLATS // 2
    assert replace(MANIFEST, capacity=(half, half)).kept_whole
    assert not replace(MANIFEST, capacity=(half, half + 1)).kept_whole
    assert replace(MANIFEST, gof_starts=(0,), capacity=(MAX_WHOLE_SPLATS + 1,)).kept_whole


def test_unknown_fields_are_left_alone() -> None:
    assert Manifest.from_json(changed(future={"a": 1})) == MANIFEST


@pytest.mark.parametrize(
    ("fields", "says"),
    [
        *(({"version": old}, f"version {old} is unknown; this program reads 9, encode again") for old in (1, 4)),
        ({"format": "zip"}, "is not a cags-bundle"),
        ({"frames": 0}, "frames = 0"),
        ({"frames": "5"}, "frames = '5' must be a whole number"),
        ({"frames": True}, "frames"),
        ({"fps": 1e9}, "fps"),
        ({"gof_starts": [1, 3]}, "gof_starts"),
        ({"gof_starts": [0, 5]}, "gof_starts"),
        ({"capacity": [10]}, "one entry for each"),
        ({"sh_degree": 4}, "sh_degree"),
        ({"bounds": [[0, 0, 0]]}, "two corners"),
        ({"bounds": [[0, 0, 0], [0, 0, None]]}, r"bounds\[1\]"),
        ({"lod_order": [["scale"]]}, "must be"),
        ({"lod_order": [["scale", 1]] * 300}, "at most"),
        ({"lod_gains_db": [1.0]}, "lod_gains_db"),
        ({"base_psnr_db": 1e9}, "base_psnr_db"),
        ({"outdated_psnr_db": 3.5}, "outdated_psnr_db"),
        ({"outdated_psnr_db": [[2, 30.0], [2, 29.0]]}, "outdated_psnr_db must rise"),
        ({"outdated_psnr_db": [[0, 30.0]]}, "outdated_psnr_db"),
        ({"still_psnr_db": [[4, 30.0], [1, 40.0]]}, "still_psnr_db"),
        ({"still_psnr_db": [[0, 30.0]]}, "still_psnr_db"),
        ({"still_psnr_db": [[1.5, 30.0]]}, "still_psnr_db"),
        ({"still_psnr_db": [[1, 30.0, 2]]}, "still_psnr_db"),
        ({"still_psnr_db": [[1, "high"]]}, "still_psnr_db"),
        ({"still_psnr_db": [[n, 30.0] for n in range(1, 100)]}, "still_psnr_db"),
        ({"up": [0, 1]}, "up must be three numbers"),
        ({"tracks": {"frames": 5}}, "tracks.changed is missing"),
        ({"tracks": TRACKS | {"linked_share": 1.5}}, r"tracks.linked_share = 1.5"),
        ({"tracks": TRACKS | {"life_histogram": [1] * 65}}, "tracks.life_histogram has 65 entries"),
        ({"tracks": TRACKS | {"changed": {}}}, "tracks.changed.position is missing"),
    ],
)
def test_what_is_wrong_is_named(fields: dict[str, object], says: str) -> None:
    with pytest.raises(BundleError, match=says):
        Manifest.from_json(changed(**fields))


@pytest.mark.parametrize("name", ["/etc/passwd", "../x", "a/../../x", "", "c:\\x", "http://x/y"])
def test_files_stay_inside_the_bundle(name: str) -> None:
    entry = {"name": name, "index_offset": 0, "index_crc": 0, "size_bytes": 1}
    with pytest.raises(BundleError, match="must stay inside"):
        Manifest.from_json(changed(gofs=[{"tiles": entry, "source": entry}] * 2))


def test_nonsense_is_refused() -> None:
    for data in (b"", b"[]", b"null", b"{", b"[" * 100_000, b"\xff"):
        with pytest.raises(BundleError):
            Manifest.from_json(data)


def test_more_levels_than_the_wire_carries_are_refused_when_the_bundle_is_opened() -> None:
    order = [["scale", layer] for layer in range(1, MAX_LODS)]
    assert Manifest.from_json(changed(lod_order=order, lod_gains_db=[])).lods == MAX_LODS
    with pytest.raises(BundleError, match="lod_order has 64 entries"):
        Manifest.from_json(changed(lod_order=[*order, ["scale", MAX_LODS]], lod_gains_db=[]))
    assert decode(encode(TileLayers(0, 0, 0, MAX_LODS, (0,) * MAX_LODS, (0,) * MAX_LODS)))[0].to_lod == MAX_LODS


def test_what_a_manifest_says_cannot_reach_a_terminal_as_control_characters() -> None:
    with pytest.raises(BundleError) as caught:
        Manifest.from_json(changed(frames="\x1b[31m"))
    assert str(caught.value).isprintable()
