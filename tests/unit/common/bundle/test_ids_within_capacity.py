"""Ids index arrays and the kernels' memory: those beyond a group's capacity are refused when they are read."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cags_common.bundle import BundlePlayer, BundleReader
from cags_common.coding.packing import encode_ids
from cags_common.errors import BundleError, DecodeError
from support.siege import encode_small


@pytest.fixture(scope="module")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return encode_small(tmp_path_factory.mktemp("clip"), "procedural:size=1000,frames=2")


def test_ids_of_tiles_and_sources_stay_within_the_capacity(bundle: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with BundleReader.open(str(bundle)) as reader:
        assert len(reader.tile_ids(0, 0))
        too_small = int(reader.tile_ids(0, 0).max())
        reader.manifest = replace(reader.manifest, capacity=(too_small,) * len(reader.manifest.capacity))
        with pytest.raises(BundleError, match=rf"frame 0, tile 0: ids 0 to {too_small} do not lie within"):
            reader.tile_ids(0, 0)
        with pytest.raises(BundleError, match="frame 0, source: ids"):
            reader.source_delta(0)
        monkeypatch.setattr(reader.codec, "tile_ids", lambda data: np.array([-1], np.int32))
        with pytest.raises(BundleError, match="ids -1 to -1"):
            reader.tile_ids(0, 0)


@pytest.mark.parametrize("capacity", [0, 3])
def test_a_player_refuses_ids_beyond_the_capacity(bundle: Path, capacity: int) -> None:
    with BundleReader.open(str(bundle)) as reader:
        reader.manifest = replace(reader.manifest, capacity=(capacity,) * len(reader.manifest.capacity))
        with pytest.raises(BundleError, match=rf"frame 0, tile 0: ids .* capacity of {capacity}"):
            BundlePlayer(reader).frame(0)


def test_a_group_without_splats_ends_none(bundle: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with BundleReader.open(str(bundle)) as reader:
        reader.manifest = replace(reader.manifest, capacity=(0,) * len(reader.manifest.capacity))
        monkeypatch.setattr(reader, "removed_payload", lambda frame: encode_ids(np.zeros(1, np.int32)))
        with pytest.raises(DecodeError, match="frame 1: claims 1 ids from 0; at most 0"):
            reader.removed_ids(1)


def test_a_capacity_that_no_tile_backs_is_refused_before_memory_is_taken(bundle: Path) -> None:
    with BundleReader.open(str(bundle)) as reader:
        reader.manifest = replace(reader.manifest, capacity=(20_000_000,) * len(reader.manifest.capacity))
        for read in (reader.frame, reader.source_delta, reader.source):
            with pytest.raises(BundleError, match=r"capacity\[0\] = 20000000 is far more than"):
                read(0)
