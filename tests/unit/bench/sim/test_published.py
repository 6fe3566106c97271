"""A published folder holds no source frames: its top level is what is rendered and compared with."""

from pathlib import Path

import numpy as np
import pytest

from cags_bench.bundles import cached_bundle
from cags_bench.sim.bundle import SOURCE, TOP_LEVEL, PublishedReader, is_bundle, open_bundle, truth_of
from cags_common.bundle import BundlePlayer, BundleReader
from cags_common.bundle.source import SourceState
from cags_encoder import EncodeSettings
from cags_encoder.bundles.publish import publish

FRAMES = 6


@pytest.fixture(scope="module")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bundles")
    settings = EncodeSettings(frames=FRAMES, gof_frames=4, train_splats=1000, lod_order="paper")
    return cached_bundle(f"procedural:size=500,frames={FRAMES}", str(folder), settings)


@pytest.fixture(scope="module")
def published(bundle: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("published") / "www"
    publish(str(bundle), folder, None)
    return folder


def test_both_are_bundles_and_say_what_pictures_are_compared_with(bundle: Path, published: Path) -> None:
    assert is_bundle(str(bundle)) and is_bundle(str(published)) and not is_bundle("procedural")
    assert (truth_of(bundle), truth_of(published)) == (SOURCE, TOP_LEVEL)
    assert not isinstance(open_bundle(bundle), PublishedReader)


def test_source_frames_are_the_top_level(bundle: Path, published: Path) -> None:
    reader, player = open_bundle(published), BundlePlayer(BundleReader.open(str(bundle)))
    for frame in range(FRAMES):
        found, expected = reader.source(frame), player.frame(frame)
        assert np.array_equal(found.ids, expected.ids)
        for (_, here), (name, there) in zip(found.splats.arrays(), expected.splats.arrays(), strict=True):
            assert np.array_equal(here, there), name


def test_changes_add_up_to_every_frame(published: Path) -> None:
    """In any order of asking: the renderer replays them, the truth takes frames whole."""
    reader, whole = open_bundle(published), open_bundle(published)
    manifest = reader.manifest
    for gof, first in enumerate(manifest.gof_starts):
        state = SourceState(manifest.capacity[gof], manifest.sh_degree)
        for frame in range(first, min(first + 4, FRAMES)):
            state.apply(reader.source_delta(frame))
            held, expected = state.frame(), whole.source(frame)
            assert np.array_equal(held.ids, expected.ids)
            for (_, here), (name, there) in zip(held.splats.arrays(), expected.splats.arrays(), strict=True):
                assert np.array_equal(here, there), name


def test_an_unchanged_frame_changes_nothing(bundle: Path, published: Path) -> None:
    """Later frames say what differs, and not everything again."""
    reader = open_bundle(published)
    assert 0 < len(reader.source_delta(1).ids) < len(reader.source_delta(0).ids)
