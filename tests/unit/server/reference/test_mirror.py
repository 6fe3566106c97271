"""A mirror holds what was sent up to a mark; what tiles decode to is shared."""

from __future__ import annotations

import threading
import uuid
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from cags_common.bundle import BundlePlayer
from cags_common.errors import DecodeError
from cags_common.motion.apply import ABSENT_LOGIT
from cags_common.tiles.inventory import InventoryEntry
from cags_protocol.wire.messages import FrameEnd, TileLayers
from cags_server.reference.mirror import Mirror, _Layers
from cags_server.scene.decoded_tiles import DecodedTiles
from cags_server.scene.library import SceneLibrary
from support.closed_loop import KeptScene, assert_same, served
from support.moving_bundle import GROUP, write_moving
from support.small_motion import moving, random_frames, written
from support.small_store import manifest


@pytest.fixture
def library() -> SceneLibrary:
    return served(write_moving(f"memory://{uuid.uuid4().hex}", 3), 64 << 20)


def send(mirror: Mirror, library: SceneLibrary, frame: int, lods: slice = slice(None)) -> None:
    """Levels of every tile of ``frame``."""
    for entry in library.entry(frame).tiles:
        levels = range(len(entry.lod_bytes))[lods]
        parts = [library.reader.payload(frame, entry.tile, lod) for lod in levels]
        sizes = tuple(map(len, parts))
        message = TileLayers(frame, entry.tile, levels.start, levels.stop, sizes, (0,) * len(sizes))
        mirror.sent(message, b"".join(parts))


def end(mirror: Mirror, library: SceneLibrary, frame: int) -> None:
    mirror.sent(FrameEnd(frame), library.reader.removed_payload(frame))


def shown(mirror: Mirror) -> np.ndarray:
    assert mirror.splats is not None
    return np.flatnonzero(mirror.splats.logit_opacities > ABSENT_LOGIT)


def test_everything_that_was_sent_is_what_the_bundle_plays(library: SceneLibrary) -> None:
    mirror, player = Mirror(library, threads=2), BundlePlayer(library.reader)
    for frame in range(library.manifest.frames):
        send(mirror, library, frame)
        end(mirror, library, frame)
        scene = mirror.scene_at(frame, mirror.mark())
        assert isinstance(scene, KeptScene) and mirror.splats is not None
        played = player.frame(frame)
        assert shown(mirror).tolist() == played.ids.tolist()
        assert_same(mirror.splats.take(played.ids), played.splats)
        assert_same(scene.splats, mirror.splats)


def test_what_is_sent_after_a_mark_is_not_in_it(library: SceneLibrary) -> None:
    mirror = Mirror(library, threads=1)
    send(mirror, library, 0, slice(0, 1))
    basis = mirror.mark()
    end(mirror, library, 0)
    assert mirror.scene_at(0, basis) is None, "no frame had ended"
    assert mirror.splats is None
    assert mirror.scene_at(0, mirror.mark()) is not None
    assert [mirror.mark() for _ in range(3)] == [3, 4, 5]


def test_a_restart_forgets_what_was_sent_and_what_was_shown(library: SceneLibrary, groups_pass: None) -> None:
    mirror = Mirror(library, threads=1)
    send(mirror, library, 0)
    end(mirror, library, 0)
    assert mirror.scene_at(0, mirror.mark()) is not None
    send(mirror, library, GROUP)
    end(mirror, library, GROUP)
    mirror.restart(GROUP)
    assert mirror.scene_at(GROUP, mirror.mark()) is None
    send(mirror, library, GROUP)
    end(mirror, library, GROUP)
    assert mirror.scene_at(GROUP, mirror.mark()) is not None
    assert mirror.scene_at(0, mirror.mark()) is None, "its group is past"


def test_a_client_that_resumes_is_taken_at_its_word_as_far_as_the_bundle_goes(library: SceneLibrary) -> None:
    whole, mirror = Mirror(library, threads=1), Mirror(library, threads=1)
    send(whole, library, 0, slice(0, 2))
    tiles = [InventoryEntry(0, entry.tile, min(2, len(entry.lod_bytes))) for entry in library.entry(0).tiles]
    mirror.resume(
        [
            *tiles,
            InventoryEntry(999, 0, 1),
            InventoryEntry(0, 999, 1),
            InventoryEntry(0, 0, 60),
            InventoryEntry(0, 0, 0),
        ]
    )
    assert mirror.scene_at(0, mirror.mark()) is None, "no frame has ended over this connection"
    for each in (whole, mirror):
        end(each, library, 0)
        each.scene_at(0, each.mark())
    assert whole.splats is not None and mirror.splats is not None
    assert_same(whole.splats, mirror.splats)


def test_clients_that_were_sent_the_same_share_what_was_decoded(library: SceneLibrary) -> None:
    mirrors = [Mirror(library, threads=1) for _ in range(8)]
    with ThreadPoolExecutor(8) as pool:
        for frame in range(GROUP):
            for mirror in mirrors:
                send(mirror, library, frame)
                end(mirror, library, frame)
            list(pool.map(lambda mirror, frame=frame: mirror.scene_at(frame, mirror.mark()), mirrors))
    tiles = sum(len(library.entry(frame).tiles) for frame in range(GROUP))
    assert library.decoded.made == tiles
    for mirror in mirrors[1:]:
        assert mirror.splats is not None and mirrors[0].splats is not None
        assert_same(mirror.splats, mirrors[0].splats)


def test_further_levels_are_built_on_those_that_are_there_to_the_same_bits(library: SceneLibrary) -> None:
    one, other = DecodedTiles(library.reader), DecodedTiles(library.reader)
    before = one.at((0, 0), 0b001)
    built, whole = one.at((0, 0), 0b111, 0b001), other.at((0, 0), 0b111)
    assert_same(built.value.splats, whole.value.splats)  # type: ignore[union-attr]
    assert_same(before.value.splats, other.at((0, 0), 0b001).value.splats)  # type: ignore[union-attr]
    assert one.at((0, 0), 0b111) is built


def test_a_client_may_tell_in_any_order_what_it_holds(library: SceneLibrary) -> None:
    """Motion that comes before its looks waits, and is discarded where much of it does."""
    mirror = Mirror(library, threads=1)
    tiles = [InventoryEntry(frame, entry.tile, 1) for frame in (2, 1, 0) for entry in library.entry(frame).tiles]
    mirror.resume(tiles)
    told = [(event.frame, event.tile) for _, event in mirror._log if isinstance(event, _Layers)]
    assert told == sorted((tile.frame, tile.tile) for tile in tiles)
    assert len(told) == len(tiles)


def test_what_is_kept_of_decoded_tiles_is_bounded(library: SceneLibrary) -> None:
    size = DecodedTiles(library.reader).at((0, 0), 1).nbytes
    assert size > 0
    tiles = DecodedTiles(library.reader, 2 * size)
    for levels in (1, 3, 7, 15, 1):
        tiles.at((0, 0), levels)
    assert tiles.made == 5, "the first had gone"
    assert tiles.nbytes <= 2 * size


def test_two_who_want_the_same_tile_wait_for_one_decoder(
    library: SceneLibrary, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked, gate = threading.Event(), threading.Event()
    payload = library.reader.payload

    def gated(*which: int) -> bytes:
        asked.set()
        assert gate.wait(10)
        return payload(*which)

    monkeypatch.setattr(library.reader, "payload", gated)
    with ThreadPoolExecutor(2) as pool:
        first = pool.submit(library.decoded.at, (0, 0), 1)
        assert asked.wait(10)
        second = pool.submit(library.decoded.at, (0, 0), 1)
        gate.set()
        assert first.result(10) is second.result(10)
    assert library.decoded.made == 1


def test_a_damaged_payload_fails_those_who_want_it_and_may_be_tried_again(
    library: SceneLibrary, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(library.reader, "payload", lambda *which: b"\x02")
        with pytest.raises(DecodeError, match="too few"):
            library.decoded.at((0, 0), 1)
    assert library.decoded.at((0, 0), 1).state.lod == 0


def test_what_waits_for_a_reference_is_forgotten_with_its_group(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, groups_pass: None
) -> None:
    of = moving(manifest(frames=9, starts=(0, 3, 6)))
    long = served(written(tmp_path, of, random_frames(np.random.default_rng(1), of)).reader, 1 << 20)
    whole = Mirror(long, threads=1)
    monkeypatch.setattr("cags_server.reference.mirror.MAX_LOG", 3)
    mirror = Mirror(long, threads=1)
    whole._most = 1000
    for each in (whole, mirror):
        for frame in range(9):
            send(each, long, frame)
            end(each, long, frame)
    assert len(mirror._log) < len(whole._log)
    assert {long.manifest.gof_of(event.frame) for _, event in mirror._log} == {1, 2}
    for each in (whole, mirror):
        each.scene_at(7, each.mark())
    assert mirror.splats is not None and whole.splats is not None
    assert_same(mirror.splats, whole.splats)


def test_ends_that_come_again_in_every_round_of_a_loop_do_not_pile_up(
    library: SceneLibrary, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cags_server.reference.mirror.MAX_LOG", 20)
    mirror = Mirror(library, threads=1)
    mirror._most = 20
    frames = library.manifest.gof_frames(0)
    for frame in frames:
        send(mirror, library, frame)
    for _ in range(100):
        for frame in frames:
            end(mirror, library, frame)
    once = len(frames) + sum(len(library.entry(frame).tiles) for frame in frames)
    assert len(mirror._log) <= once + 40
    mirror.scene_at(frames[-1], mirror.mark())
    assert mirror.splats is not None
    played = BundlePlayer(library.reader).frame(frames[-1])
    assert_same(mirror.splats.take(played.ids), played.splats)


def test_what_waits_is_taken_in_while_nothing_is_compared(
    library: SceneLibrary, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("cags_server.reference.mirror.FOLLOWS_AT", 3)
    compared, followed = Mirror(library, threads=1), Mirror(library, threads=1)
    for mirror in (compared, followed):
        for frame in range(3):
            send(mirror, library, frame)
            end(mirror, library, frame)
    followed.follow(1, followed.mark())
    assert not followed._log
    for mirror in (compared, followed):
        mirror.scene_at(2, mirror.mark())
    assert compared.splats is not None
    assert followed.splats is not None
    assert_same(compared.splats, followed.splats)


def test_memory_is_that_of_the_splats_once_more_in_the_renderer(library: SceneLibrary) -> None:
    mirror = Mirror(library, threads=1)
    assert mirror.memory_bytes == 0
    send(mirror, library, 0)
    end(mirror, library, 0)
    mirror.scene_at(0, mirror.mark())
    assert mirror.splats is not None
    once = sum(array.nbytes for _, array in mirror.splats.arrays())
    assert 2 * once < mirror.memory_bytes < 4 * once
