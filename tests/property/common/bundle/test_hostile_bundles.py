"""Damaged bundles give frames or one line of BundleError or DecodeError. 2,000 cases, 100,000 with ``-m nightly``.

Half of the damage lies inside what CRCs and gzip would catch: it is packed again with CRCs that fit.
"""

from __future__ import annotations

import tracemalloc
import warnings
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from cags_common.bundle import BundlePlayer, BundleReader, Manifest
from cags_common.bundle.index import MAX_INDEX_BYTES
from cags_common.bundle.source import decode_source
from cags_common.coding.packing import crc32, gunzip_bounded, gzip_bytes
from cags_common.errors import BundleError, DecodeError
from cags_encoder import EncodeSettings, encode
from support.codec_scenes import cloud, with_changes
from support.mutation import mutate

NAMES = ("manifest.json", "codebooks.bin", "gof_0000.bin", "source/gof_0000.bin", "quality.json")
PEAK_BYTES = 64 << 20


class FilesInMemory:
    """A bundle's files in memory."""

    def __init__(self, files: dict[str, bytes]) -> None:
        self.files = files

    def has(self, name: str) -> bool:
        return name in self.files

    def read(self, name: str, start: int, end: int) -> bytes:
        data = self.read_all(name, 1 << 40)[start:end]
        if len(data) != end - start:
            raise BundleError(f"{name}: is cut short")
        return data

    def read_all(self, name: str, limit_bytes: int) -> bytes:
        if name not in self.files:
            raise BundleError(f"has no {name}")
        return self.files[name]


@cache
def whole(url: str = "memory://hostile") -> dict[str, bytes]:
    """The files of a bundle of three small frames with splats that change, come and go."""
    import fsspec

    first = cloud(60, 1, 1)
    moved = with_changes(first, means=first.means + np.float32(0.01))
    encode([first, moved.take(np.arange(50)), moved], EncodeSettings(train_splats=256, lod_order="measured"), url)
    fs, path = fsspec.core.url_to_fs(url)
    return {name: fs.cat_file(f"{path}/{name}") for name in NAMES if fs.exists(f"{path}/{name}")}


def damaged_inside(rng: np.random.Generator) -> dict[str, bytes]:
    """The index of the tiles or of the source frames, damaged and packed again."""
    files = dict(whole())
    manifest = Manifest.from_json(files["manifest.json"])
    which = "tiles" if rng.integers(2) else "source"
    entry = getattr(manifest.gofs[0], which)
    index = files[entry.name][entry.index_offset :]
    packed = gzip_bytes(mutate(gunzip_bounded(index, MAX_INDEX_BYTES, "index"), rng))
    files[entry.name] = files[entry.name][: entry.index_offset] + packed
    changed = replace(entry, index_crc=crc32(packed), size_bytes=entry.index_offset + len(packed))
    gofs = (replace(manifest.gofs[0], **{which: changed}),)
    files["manifest.json"] = replace(manifest, gofs=gofs).to_json()
    return files


def damaged(rng: np.random.Generator) -> dict[str, bytes]:
    files = dict(whole())
    victim = str(rng.choice(sorted(files)))
    files[victim] = mutate(files[victim], rng)
    return files


def plays(files: dict[str, bytes]) -> bool:
    """Whether the bundle opens and plays; any other error than the two that are promised fails the test."""
    store = FilesInMemory(files)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            manifest = Manifest.from_json(store.read_all("manifest.json", 1 << 24))
            if not manifest.gofs:
                return False
            reader = BundleReader(store, manifest, store.read_all("codebooks.bin", 1 << 24))
            reader.quality()
            for frame in range(min(manifest.frames, 3)):
                BundlePlayer(reader).frame(frame)
                reader.source(frame)
        except (BundleError, DecodeError) as error:
            assert "\n" not in str(error)
            return False
    return True


def source_payload(rng: np.random.Generator) -> None:
    data = whole()["source/gof_0000.bin"][8:]
    try:
        _ = decode_source(mutate(data, rng), "x").splats
    except (BundleError, DecodeError) as error:
        assert str(error).startswith("x")


def fuzz(cases: int, seed: int) -> int:
    read = 0
    for case in range(cases):
        rng = np.random.default_rng((seed, case))
        source_payload(rng)
        read += plays(damaged(rng) if case % 2 else damaged_inside(rng))
    return read


def test_a_whole_bundle_plays() -> None:
    assert plays(whole())


def test_damaged_bundles() -> None:
    assert 0 < fuzz(2_000, seed=1) < 2_000


def test_memory_stays_within_its_bound() -> None:
    fuzz(5, seed=0)
    tracemalloc.start()
    try:
        for case in range(200):
            rng = np.random.default_rng((3, case))
            files = damaged(rng) if case % 2 else damaged_inside(rng)
            tracemalloc.reset_peak()
            before = tracemalloc.get_traced_memory()[0]
            plays(files)
            assert tracemalloc.get_traced_memory()[1] - before < PEAK_BYTES, case
    finally:
        tracemalloc.stop()


@pytest.mark.nightly
@pytest.mark.timeout(3600)
def test_damaged_bundles_at_length() -> None:
    fuzz(100_000, seed=2)
