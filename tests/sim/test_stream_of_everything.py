"""A client that is sent everything shows what the bundle decodes to, whatever the codec."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cags_common.bundle import BundleReader
from cags_common.bundle.codecs import TILE_CODECS
from cags_common.bundle.player import BundlePlayer
from cags_common.coding.packing import decode_ids
from cags_common.motion.apply import ABSENT_LOGIT
from cags_common.splats import Splats
from cags_common.store.gof_buffer import GofBuffer
from cags_common.store.tile_store import TileStore
from cags_encoder import EncodeSettings, encode
from cags_protocol import events as ev
from cags_protocol.wire.messages import FrameEnd, TileLayers
from support.codec_scenes import cloud, with_changes
from support.server_scene import SETTINGS
from support.streamer_rig import Rig

FRAMES, COUNT = 4, 300


def clip() -> list[Splats]:
    """A cloud ahead of the viewer; some of it moves and some of it comes and goes."""
    whole = cloud(COUNT, 7)
    frames = []
    for k in range(FRAMES):
        means = 0.4 * whole.means + np.float32([0, 0, 6])
        means[:40, 1] += np.float32(0.1 * k)
        frames.append(with_changes(whole, means=means).take(np.arange(COUNT - 5 * k)))
    return frames


@pytest.fixture(scope="module", params=sorted(TILE_CODECS.names()))
def bundle(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[BundleReader]:
    url = str(tmp_path_factory.mktemp("bundles") / request.param)
    encode(clip(), EncodeSettings(codec=request.param, train_splats=256, lod_order="paper"), url)
    with BundleReader.open(url) as reader:
        yield reader


def take(store: TileStore, sent: ev.Outgoing) -> None:
    payload = memoryview(sent.payload)
    if isinstance(sent.message, TileLayers):
        store.add(sent.message.frame, sent.message.tile, sent.message.from_lod, sent.message.split(payload))
    elif isinstance(sent.message, FrameEnd):
        ids = decode_ids(payload, what="removed", limit=COUNT) if payload else np.zeros(0, np.int32)
        store.end(sent.message.frame, ids)


def assert_shows(gof: GofBuffer, wanted: BundlePlayer, frame: int) -> None:
    decoded = wanted.frame(frame)
    shown = np.flatnonzero(gof.splats.logit_opacities > ABSENT_LOGIT)
    assert shown.tolist() == decoded.ids.tolist()
    for (name, mine), (_, theirs) in zip(gof.splats.take(shown).arrays(), decoded.splats.arrays(), strict=True):
        assert np.array_equal(mine, theirs), name


@pytest.mark.parametrize("opening", [True, False])
def test_everything_that_was_sent_is_shown(bundle: BundleReader, opening: bool) -> None:
    rig = Rig(replace(SETTINGS, abr="utility", opening_tiles=opening), initial_bps=1e12, reader=bundle)
    rig.play()
    store = TileStore(bundle.manifest, bundle.codec)
    for sent in rig.opening:
        take(store, sent)
    for frame in range(FRAMES):
        for sent in rig.step():
            take(store, sent)
        gof, committed = store.commit(frame)
        assert not committed.missed
    assert_shows(gof, BundlePlayer(bundle), FRAMES - 1)


def test_whole_tiles_may_come_at_any_level_and_the_best_stays(tmp_path: Path) -> None:
    url = str(tmp_path / "clip")
    encode(clip()[:1], EncodeSettings(codec="video", train_splats=256), url)
    with BundleReader.open(url) as reader:
        tiles = range(len(reader.frame(0).tiles))
        for levels in ((2,), (2, 0), (1, 3), (3, 1)):
            store = TileStore(reader.manifest, reader.codec)
            for level in levels:
                for tile in tiles:
                    store.add(0, tile, level, [memoryview(reader.payload(0, tile, level))])
            store.end(0, np.zeros(0, np.int32))
            gof, _ = store.commit(0)
            found = gof.splats.sh0[: len(reader.source(0).ids)]
            whole = [reader.codec.open_tile(reader.payload(0, tile, max(levels))) for tile in tiles]
            ids = np.concatenate([tile.ids for tile in whole])
            wanted = np.concatenate([tile.dequantise().sh0 for tile in whole])[np.argsort(ids)]
            assert np.array_equal(found, wanted)
