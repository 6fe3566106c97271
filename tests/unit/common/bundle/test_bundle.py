import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cags_common.bundle import BundleReader, BundleWriter, LodLayer, Manifest, SourceDelta, TilePayloads
from cags_common.bundle.source import SourceState, decode_source, encode_source, head_bytes
from cags_common.bundle.store import UrlStore
from cags_common.bundle.writer import store_weights
from cags_common.errors import BundleError, CagsError, DecodeError
from cags_common.tiles.payloads import PositionGrid, encode_base, encode_layer
from support.codec_scenes import books, cloud

BOOKS = books((4, 2))
ORDER = tuple(LodLayer(name, 1) for name in BOOKS.attributes)
NOBODY = np.zeros(0, np.int32)


def tile(ids: np.ndarray, seed: int, *, id_range: bool) -> TilePayloads:
    random, means = np.random.default_rng(seed), cloud(len(ids), seed).means
    base = {name: random.integers(0, 16, len(ids)).astype(np.uint32) for name in BOOKS.attributes}
    layers = [encode_layer(random.integers(0, 4, len(ids)).astype(np.uint32), 2) for _ in ORDER]
    first = encode_base(ids, means, base, PositionGrid.over(means, 12), BOOKS, id_range=id_range)
    corner = (0.0, 0.0, 0.0)
    return TilePayloads(len(ids), int(ids[0]) if id_range else None, (corner, corner), (first, *layers))


def write(url: str) -> Manifest:
    """Two groups: a key frame and a later one that changes, adds and removes; then a lone key frame."""
    manifest = Manifest("t", 30.0, 3, (0, 2), (25, 10), 0, ((0, 0, 0), (1, 1, 1)), ORDER, (), "svq", "paper-66")
    with BundleWriter(url) as writer:
        writer.codebooks(BOOKS.to_bytes())
        group = writer.open_gof(0, len(ORDER) + 1)
        ids = np.arange(20, dtype=np.int32)
        tiles = [tile(ids[:10], 1, id_range=True), tile(ids[10:], 2, id_range=True)]
        group.frame(tiles, NOBODY, encode_source(SourceDelta(ids, cloud(20), NOBODY)))
        some, gone = np.array([3, 7, 24], np.int32), np.array([0, 19], np.int32)
        group.frame([tile(some, 3, id_range=False)], gone, encode_source(SourceDelta(some, cloud(3, 9), gone)))
        group.close()
        group = writer.open_gof(2, len(ORDER) + 1)
        ids = np.arange(10, dtype=np.int32)
        group.frame([tile(ids, 4, id_range=True)], NOBODY, encode_source(SourceDelta(ids, cloud(10), NOBODY)))
        group.close()
        return writer.commit(manifest)


@pytest.fixture(params=["folder", "memory"])
def url(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    return str(tmp_path / "out") if request.param == "folder" else f"memory://{tmp_path.name}/out"


def test_a_manifest_that_no_reader_takes_is_not_written_over_a_good_one(url: str) -> None:
    good = write(url)
    with pytest.raises(BundleError, match="fps"), BundleWriter(url) as writer:
        writer.commit(replace(good, fps=1e9, gofs=()))
    with BundleReader.open(url) as reader:
        assert reader.manifest == good


def test_what_was_written_is_read(url: str) -> None:
    manifest = write(url)
    with BundleReader.open(url) as reader:
        assert reader.manifest == manifest
        assert [reader.frame(i).keyframe for i in range(3)] == [True, False, True]
        assert [t.first_id for t in reader.frame(0).tiles] == [0, 10]
        assert reader.tile_ids(0, 1).tolist() == list(range(10, 20))
        assert reader.tile_ids(1, 0).tolist() == [3, 7, 24]
        assert reader.removed_ids(1).tolist() == [0, 19]
        assert reader.removed_ids(0).tolist() == []
        assert reader.payload(0, 1, 2) == tile(np.arange(10, 20, dtype=np.int32), 2, id_range=True).payloads[2]


def test_source_frames_are_lossless_in_any_order(url: str) -> None:
    write(url)
    reader = BundleReader.open(url)
    for frame in (1, 0, 2, 1):
        source = reader.source(frame)
        if frame == 1:
            assert source.ids.tolist() == [i for i in range(20) if i not in (0, 19)] + [24]
            assert np.array_equal(source.splats.means[source.ids == 24], cloud(3, 9).means[2:])
        else:
            assert np.array_equal(source.splats.quats, cloud(len(source.ids)).quats)


def test_the_same_frames_give_the_same_bytes(tmp_path: Path) -> None:
    for name in ("a", "b"):
        write(str(tmp_path / name))
    files = sorted(p.relative_to(tmp_path / "a") for p in (tmp_path / "a").rglob("*") if p.is_file())
    assert len(files) == 6
    assert all((tmp_path / "a" / f).read_bytes() == (tmp_path / "b" / f).read_bytes() for f in files)


def test_a_failure_leaves_nothing_behind_and_keeps_the_old_bundle(url: str, tmp_path: Path) -> None:
    if not url.startswith("memory"):
        write(url)
    with pytest.raises(RuntimeError, match="boom"), BundleWriter(url) as writer:
        writer.open_gof(0, 1)
        raise RuntimeError("boom")
    if url.startswith("memory"):
        with pytest.raises(BundleError, match="is it a bundle"):
            BundleReader.open(url)
    else:
        assert BundleReader.open(url).manifest.frames == 3
        assert [p.name for p in tmp_path.iterdir()] == ["out"]


def test_something_else_is_never_overwritten(tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.txt").write_text("x")
    with pytest.raises(BundleError, match="is not a bundle"):
        BundleWriter(str(tmp_path / "mine"))
    (tmp_path / "file").write_text("x")
    with pytest.raises(BundleError, match="is not a bundle"):
        BundleWriter(str(tmp_path / "file"))


def test_a_store_that_cannot_be_reached_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def unreachable(url: str) -> None:
        raise OSError("Name or service not known")

    monkeypatch.setattr("fsspec.core.url_to_fs", unreachable)
    with pytest.raises(BundleError, match=r"ftp://far/x: cannot be opened \(Name or service not known\)"):
        BundleReader.open("ftp://far/x")


def test_what_is_missing_or_outside_is_named(tmp_path: Path) -> None:
    with pytest.raises(BundleError, match="no such folder"):
        BundleReader.open(str(tmp_path / "nothing"))
    (tmp_path / "notes").write_text("no bundle")
    with pytest.raises(BundleError, match="is a file, and a bundle is a folder"):
        BundleReader.open(str(tmp_path / "notes"))
    with pytest.raises(BundleError, match=r"has no manifest\.json; is it a bundle"):
        BundleReader.open(str(tmp_path))
    with pytest.raises(BundleError, match="cannot be opened"):
        BundleReader.open("nonsense://x")
    write(str(tmp_path / "out"))
    reader = BundleReader.open(str(tmp_path / "out"))
    with pytest.raises(BundleError, match="frame 3 is outside"):
        reader.frame(3)
    with pytest.raises(BundleError, match="no tile 2"):
        reader.payload(0, 2, 0)
    with pytest.raises(BundleError, match="LoD 6 is outside"):
        reader.payload(0, 0, 6)


def test_one_flipped_byte_anywhere_is_noticed(tmp_path: Path) -> None:
    write(str(tmp_path / "out"))
    file = tmp_path / "out" / "gof_0000.bin"
    intact = file.read_bytes()
    for at in range(8, len(intact), 37):
        file.write_bytes(intact[:at] + bytes([intact[at] ^ 0x10]) + intact[at + 1 :])
        with pytest.raises(CagsError):
            read_everything(str(tmp_path / "out"))
    file.write_bytes(intact[:-40])
    with pytest.raises(BundleError, match="cut short"):
        read_everything(str(tmp_path / "out"))


def read_everything(url: str) -> None:
    reader = BundleReader.open(url)
    for frame in range(reader.manifest.frames):
        reader.removed_ids(frame)
        for entry in reader.frame(frame).tiles:
            for lod in range(reader.manifest.lods):
                reader.payload(frame, entry.tile, lod)


def test_source_frames_of_every_sh_degree_and_of_no_splats() -> None:
    for degree in range(4):
        for n in (0, 1, 50):
            delta = SourceDelta(np.arange(n, dtype=np.int32), cloud(n, 1, degree), NOBODY)
            back = decode_source(encode_source(delta), "x")
            for (_, a), (_, b) in zip(delta.splats.arrays(), back.splats.arrays(), strict=True):
                assert np.array_equal(a, b) and a.shape == b.shape
    with pytest.raises(DecodeError):
        _ = decode_source(encode_source(delta)[:-3], "x").splats


def moving_delta(degree: int = 3) -> tuple[SourceDelta, SourceDelta]:
    """A frame of ten splats, and one in which two appear, two go and five move."""
    first = SourceDelta(np.arange(10, dtype=np.int32), cloud(10, 1, degree), NOBODY)
    ids = np.array([1, 2, 4, 5, 8, 10, 11], np.int32)
    other = SourceDelta(ids, cloud(7, 2, degree), np.array([3, 9], np.int32))
    kept = ids < 10
    for (name, values), (_, before) in zip(other.splats.arrays(), first.splats.arrays(), strict=True):
        if name not in ("means", "quats", "logit_opacities"):
            values[kept] = before[ids[kept]]
    return first, other.keeping(kept)


@pytest.mark.parametrize("degree", range(4))
def test_source_frames_hold_only_places_of_splats_that_keep_their_looks(degree: int) -> None:
    first, moving = moving_delta(degree)
    back = decode_source(encode_source(moving), "x")
    assert (back.ids.tolist(), back.moved.ids.tolist(), back.removed.tolist()) == ([10, 11], [1, 2, 4, 5, 8], [3, 9])
    assert back.changes
    state = SourceState(12, degree)
    state.apply(first)
    state.apply(back)
    now = state.frame()
    assert now.ids.tolist() == [0, 1, 2, 4, 5, 6, 7, 8, 10, 11]
    whole, still = cloud(7, 2, degree), cloud(10, 1, degree)
    for name, values in now.splats.arrays():
        new, old = getattr(whole, name), getattr(still, name)
        places = name in ("means", "quats", "logit_opacities")
        np.testing.assert_array_equal(values[[8, 9]], new[5:])
        np.testing.assert_array_equal(values[[1, 2, 3, 4, 7]], new[:5] if places else old[[1, 2, 4, 5, 8]])
        np.testing.assert_array_equal(values[[0, 5, 6]], old[[0, 6, 7]])


def test_a_source_frame_that_moves_what_its_group_does_not_have_is_refused() -> None:
    _, moving = moving_delta()
    with pytest.raises(BundleError, match="id 11"):
        SourceState(11, 3).apply(moving)
    with pytest.raises(BundleError, match="id 8"):
        SourceState(8, 3).apply(SourceDelta(NOBODY, cloud(0, 1, 3), NOBODY, moving.moved))


def test_places_are_unpacked_without_looks_and_looks_without_places() -> None:
    moving = moving_delta()[1]
    good, ids = encode_source(moving), len(moving.ids) + len(moving.moved_ids)
    looks, places = (int.from_bytes(good[at : at + 4], "little") for at in (28, 32))
    without_looks = bytearray(good)
    without_looks[-places - looks : -places] = bytes(looks)
    back = decode_source(bytes(without_looks), "x")
    np.testing.assert_array_equal(back.places, moving.places)
    assert back.places.shape == (ids, 8)
    with pytest.raises(DecodeError, match=r"^x: "):
        _ = back.looks
    back = decode_source(good[:-places] + bytes(places), "x")
    np.testing.assert_array_equal(back.looks.sh_rest, moving.looks.sh_rest)
    with pytest.raises(DecodeError, match=r"^x: "):
        _ = back.places
    assert moving.nbytes == decode_source(good, "x").nbytes
    head, asked = good[: head_bytes(good)], []

    def read(first: int, end: int) -> bytes:
        asked.append((first, end))
        return good[first:end]

    back = decode_source(head, "x", read)
    assert back.ids.tolist() == moving.ids.tolist() and back.packed_bytes == len(good) and not asked
    np.testing.assert_array_equal(back.moved.means, moving.moved.means)
    assert asked == [(len(good) - places, len(good))]


def test_damaged_source_frames_are_refused() -> None:
    good = encode_source(moving_delta()[1])
    for data, what in (
        (good[:10], "cut short"),
        (good[:20], "cut short"),
        (b"\x02" + good[1:], "version 2"),
        (good[:4] + b"\xff" * 4 + good[8:], "beyond what this program reads"),
        (good[:4] + b"\x03\x00\x00\x00" + good[8:], "claims 2 ids for 3 splats"),
        (good[:-1], "cut short"),
    ):
        with pytest.raises((BundleError, DecodeError), match=f"^x: .*{what}"):
            _ = decode_source(data, "x").places


def test_weights_are_added_replaced_and_checked(url: str) -> None:
    write(url)
    with BundleReader.open(url) as reader:
        assert reader.weights() is None
    for data in (b"first weights", b"second", b"second"):
        store_weights(url, data)
        with BundleReader.open(url) as reader:
            assert reader.weights() == data
    read_everything(url)


def test_damaged_weights_are_noticed_and_too_many_refused(tmp_path: Path) -> None:
    url = str(tmp_path / "bundle")
    write(url)
    store_weights(url, b"weights")
    (file,) = (tmp_path / "bundle").glob("weights-*.npz")
    file.write_bytes(b"weighty")
    with BundleReader.open(url) as reader, pytest.raises(DecodeError, match=r"weights-.*CRC"):
        reader.weights()
    with pytest.raises(BundleError, match="more than the allowed"):
        store_weights(url, bytes(5 << 20))


class GatedStore(UrlStore):
    """A store whose files that begin with ``slow`` are read only once the gate is open."""

    def __init__(self, url: str, slow: str) -> None:
        super().__init__(url)
        self._slow, self.asked, self.gate = slow, threading.Event(), threading.Event()

    def read(self, name: str, start: int, end: int) -> bytes:
        if name.startswith(self._slow) and end - start > 8:
            self.asked.set()
            assert self.gate.wait(10)
        return super().read(name, start, end)


@pytest.mark.parametrize(("slow", "work"), [("source/", "source"), ("gof_0001", "removed_payload")])
def test_a_slow_read_holds_up_nobody_who_wants_something_else(url: str, slow: str, work: str) -> None:
    manifest = write(url)
    store = GatedStore(url, slow)
    reader = BundleReader(store, manifest, BOOKS.to_bytes())
    store.gate.set()
    reader.frame(2)  # indices are read once, and then known
    reader.payload(0, 0, 0)
    store.gate.clear()
    with ThreadPoolExecutor(2) as pool:
        waits = pool.submit(getattr(reader, work), 2)
        assert store.asked.wait(10)
        try:
            assert pool.submit(reader.payload, 0, 0, 0).result(5)
            assert not waits.done()
        finally:
            store.gate.set()
        waits.result(10)


def test_what_answers_from_memory_is_told(url: str) -> None:
    reader = BundleReader(UrlStore(url), write(url), BOOKS.to_bytes())
    assert not reader.at_hand(2)
    reader.frame(2)
    assert not reader.at_hand(2), "its bytes are not there"
    reader.payload(2, 0, 0)
    assert reader.at_hand(2)
    assert not reader.at_hand(0)
    reader.close()
    assert not reader.at_hand(2)


def test_a_store_whose_package_is_missing_is_told_with_what_brings_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "s3fs", None)
    with pytest.raises(BundleError, match=r"^s3://far/x: .*s3fs.*; pip install 'cags-stream\[scale\]'"):
        BundleReader.open("s3://far/x")
