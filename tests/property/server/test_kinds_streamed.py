"""A client that was sent everything that the server chose shows what is true, whatever the bundle's tiles are."""

from __future__ import annotations

import math
import uuid
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from cags_common.bundle import SourceFrame
from cags_common.geometry import Camera, Pose
from cags_common.motion.chunk import DEADZONES, LEVELS, REFINEMENT
from cags_common.splats import Splats
from cags_common.tiles.inventory import InventoryEntry
from cags_common.tiles.kinds import TileKind
from cags_common.tiles.updates import UpdateState
from cags_protocol import events as ev
from cags_protocol.wire.messages import Control, PoseSample, TileLayers
from cags_server.link import MeasuredLink
from cags_server.scene.library import SceneLibrary
from cags_server.session.streamer import Streamer
from support.examples import examples
from support.moving_bundle import FRAMES, moving_library
from support.server_scene import SETTINGS, hello
from support.shadow_client import ShadowClient
from support.streamer_rig import OFFSET_US

UNLIMITED_BPS = 1e10


@pytest.fixture(scope="module", autouse=True)
def _every_frame_ahead_is_drawn() -> Iterator[None]:
    """What is chosen for a frame is what is seen there: else a frame before it stands for it, unless much is new."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("cags_server.reference.job.MANY_NEW", -1.0)
        yield


class Viewer:
    """A viewer who looks about at random, and a link without bounds."""

    def __init__(self, library: SceneLibrary, seed: int, abr: str, held: ShadowClient | None = None) -> None:
        self.library, self._random = library, np.random.default_rng(seed)
        settings = replace(SETTINGS, abr=abr, predictor="hold")
        self.pose = self._look()
        self.client = held or ShadowClient(library.reader)
        start = int(self._random.integers(0, FRAMES)) if seed % 2 else 0
        self.streamer = Streamer(
            library, settings, hello(self.pose, start_frame=start), link=MeasuredLink(UNLIMITED_BPS)
        )
        if held is not None:
            self.streamer.resume(inventory_of(held))
        self.planned: list[int] = []
        self.now_us = OFFSET_US
        self.take(self.streamer.startup(self.now_us))
        greeting = self.streamer.begin(self.now_us)
        self.take([] if greeting is None else self.streamer.finish(greeting.run(), self.now_us))
        self.play(start)

    def _look(self) -> Pose:
        yaw = float(self._random.uniform(-1.2, 1.2))
        return Pose.looking_at((0, 0, 0), (math.sin(yaw), 0, math.cos(yaw)), (0, -1, 0))

    def take(self, outgoing: list[ev.Outgoing], delivers: Callable[[ev.Outgoing], bool] = lambda each: True) -> None:
        for each in outgoing:
            self.streamer.on_event(ev.Sent(each, self.now_us), self.now_us)
            if delivers(each) or not isinstance(each.message, TileLayers):
                self.client.take([each])
                self.streamer.on_event(ev.Delivered(each, 0), self.now_us)
            else:
                self.streamer.on_event(ev.Dropped(each, "late", 0, 0), self.now_us)

    def play(self, frame: int, action: str = "play", *, at_us: int = 300_000) -> None:
        self.poses(at_us - 300_000, at_us - 290_000)
        control = Control(action, frame, at_us, loop=False, keeps=True)
        self.streamer.on_event(ev.ControlReceived(control, self.now_us), self.now_us)

    def poses(self, *times_us: int) -> None:
        samples = tuple(PoseSample(t, self.pose) for t in times_us)
        self.streamer.on_event(ev.PosesReceived(samples, OFFSET_US + times_us[-1]), self.now_us)

    def step(self, delivers: Callable[[ev.Outgoing], bool] = lambda each: True) -> int | None:
        """Plan the next frame: the number of that whose tiles are sent with it; None after the last."""
        due_us = self.streamer.frame_due_us()
        if due_us is None:
            return None
        self.now_us = max(due_us, self.now_us)
        job = self.streamer.begin(self.now_us)
        assert job is not None
        begins = self.streamer._tiles.from_nothing  # with what belongs to the frame itself
        out = self.streamer.finish(job.run(), self.now_us)
        frame = job.plan.ahead.frame
        self.planned.append(frame)
        for each in out:
            if isinstance(each.message, TileLayers):
                assert_is_current(self.library, each.message, job.plan.frame if begins else frame)
        self.take(out, delivers)
        return frame

    def turn(self) -> None:
        """Look elsewhere, long enough for the server to know."""
        self.pose = self._look()
        self.poses(self.now_us - OFFSET_US, self.now_us - OFFSET_US + 1000)


def inventory_of(client: ShadowClient) -> list[InventoryEntry]:
    """What a client says that it holds: LoDs from 0 without a gap."""
    return [InventoryEntry(*key, next(n for n in range(65) if n not in layers)) for key, layers in client.held.items()]


def assert_is_current(library: SceneLibrary, message: TileLayers, frame: int) -> None:
    """Nothing of motion that a newer chunk has replaced."""
    tiles = library.tile_map(frame)
    number = tiles.number(message.frame, message.tile)
    if tiles.kinds[number] == TileKind.MOTION:
        newest = int(tiles.chunk_at(tiles.looks[number : number + 1], frame)[0])
        assert number >= newest, f"chunk {tiles.key(number)} was sent at {frame}, after {tiles.key(newest)} began"


def in_picture(splats: Splats, camera: Camera) -> np.ndarray:
    rotation, translation = camera.world_to_camera
    x, y, z = (splats.means @ rotation.T + translation).T
    k = camera.intrinsics
    z = np.where(z == 0, 1e-9, z)
    inside = (abs(x / z * k.fx_px) < k.width_px / 2) & (abs(y / z * k.fy_px) < k.height_px / 2)
    return np.asarray((splats.logit_opacities > -10) & (z > camera.near) & inside)


def assert_shows_the_truth(viewer: Viewer, frame: int, *, exact: bool = True, ghosts: bool = False) -> None:
    camera = Camera(hello().intrinsics, viewer.pose, 0.05)
    truth = viewer.library.reader.source(frame)
    seen = in_picture(truth.splats, camera)
    ids, splats = viewer.client.shown(frame)
    missing = np.setdiff1d(truth.ids[seen], ids)
    assert not len(missing), f"frame {frame}: {missing.tolist()} are not there"
    phantom = np.setdiff1d(ids[in_picture(splats, camera)], truth.ids[seen])
    phantom = phantom[~coarsely_there(viewer, ids, splats, truth, phantom)]
    assert ghosts or not len(phantom), f"frame {frame}: ghosts {phantom.tolist()}"
    if not exact:
        return
    where, begun = np.searchsorted(ids, truth.ids[seen]), on_its_way(viewer, frame)
    for (name, shown), (_, true) in zip(splats.take(where).arrays(), truth.splats.take(seen).arrays(), strict=True):
        same = np.isclose(shown, true).all(axis=tuple(range(1, true.ndim)))
        wrong = np.setdiff1d(truth.ids[seen][~same], begun.get(name, []))
        assert not len(wrong), f"frame {frame}: {name} of {wrong.tolist()}"


def on_its_way(viewer: Viewer, frame: int) -> dict[str, np.ndarray]:
    """Column -> splats that a ramp has not brought to their new value, and that had an older update of which the
    viewer lacks levels: a ramp begins at what the client has, and older updates of what was out of sight are not sent
    after a newer.
    """
    library, found, lacked = viewer.library, dict[str, list[int]](), dict[str, set[int]]()
    first = library.gof_start(frame)
    for at, tile in ((f, tile) for f in range(first, frame + 1) for tile in library.entry(f).tiles):
        if tile.kind != TileKind.UPDATE:
            continue
        state = library.reader.open_tile(at, tile.tile)
        assert isinstance(state, UpdateState)
        for column, change in state.values().items():
            older = lacked.setdefault(column, set())
            coming = change.ids[at + change.frames.astype(int) > frame + 1].tolist()
            found.setdefault(column, []).extend(i for i in coming if i in older)
            told = {lod for lod, size in enumerate(tile.lod_bytes) if size}
            if not told <= viewer.client.held.get((at, tile.tile), {}).keys():
                older.update(change.ids.tolist())
    return {column: np.array(ids) for column, ids in found.items()}


def coarsely_there(
    viewer: Viewer, ids: np.ndarray, splats: Splats, truth: SourceFrame, which: np.ndarray
) -> np.ndarray:
    """Whether each of ``which`` is shown where it truly is, as far as the first level of its motion tells."""
    motion = viewer.library.manifest.motion
    here = np.isin(which, truth.ids)
    if motion is None or not here.any():
        return np.zeros(len(which), bool)
    bound = max(motion.moves) * REFINEMENT ** (LEVELS - 1) * (0.51 + DEADZONES[0])
    true = truth.splats.means[np.minimum(np.searchsorted(truth.ids, which), len(truth.ids) - 1)]
    away = np.abs(splats.means[np.searchsorted(ids, which)] - true).max(axis=1, initial=0.0)
    return here & (away <= bound)


@pytest.mark.parametrize("abr", ["utility", "paper", "buffer"])
@given(seed=st.integers(0, 10_000), motion=st.booleans(), turns=st.booleans())
@settings(max_examples=examples(20), deadline=None)
def test_what_is_in_view_is_true_at_every_frame_on_a_link_without_bounds(
    abr: str, seed: int, motion: bool, turns: bool
) -> None:
    library = moving_library(f"memory://{uuid.uuid4().hex}", seed, motion=motion)
    viewer = Viewer(library, seed, abr)
    while (frame := viewer.step()) is not None:
        assert_shows_the_truth(viewer, frame, exact=abr != "paper")  # whose new tiles rise to a mean depth alone
        if turns:
            viewer.turn()
    assert viewer.planned
    assert viewer.client.again == []


@given(seed=st.integers(0, 10_000), motion=st.booleans())
@settings(max_examples=examples(8), deadline=None)
def test_a_client_that_resumes_in_the_middle_is_sent_what_it_lacks_and_nothing_again(seed: int, motion: bool) -> None:
    library = moving_library(f"memory://{uuid.uuid4().hex}", seed, motion=motion)
    before = Viewer(library, seed - seed % 2, "utility")
    for _ in range(4):
        before.step()
    viewer = Viewer(library, seed | 1, "utility", before.client)
    while (frame := viewer.step()) is not None:
        assert_shows_the_truth(viewer, frame)
    assert viewer.client.again == []


@given(seed=st.integers(0, 10_000), motion=st.booleans())
@example(seed=4701, motion=True)  # the base of an update is lost while its levels arrive
@settings(max_examples=examples(8), deadline=None)
def test_what_was_given_up_or_lost_comes_again_and_a_jump_sends_nothing_twice(seed: int, motion: bool) -> None:
    library, random = moving_library(f"memory://{uuid.uuid4().hex}", seed, motion=motion), np.random.default_rng(seed)
    viewer = Viewer(library, seed - seed % 2, "utility")
    for _ in range(4):
        viewer.step()
    for key in [key for key in viewer.client.held if random.random() < 0.5]:
        del viewer.client.held[key]
        viewer.streamer.on_event(ev.Evicted((InventoryEntry(*key, 0),)), viewer.now_us)
    lost = viewer.step(delivers=lambda each: random.random() < 0.5)
    assert lost is not None
    viewer.play(2, "seek", at_us=viewer.now_us - OFFSET_US + 300_000)
    while (frame := viewer.step()) is not None:
        # What was sent for later frames hides from the server which older version the client shows meanwhile.
        assert_shows_the_truth(viewer, frame, ghosts=True)
    assert viewer.client.again == []


@given(seed=st.integers(0, 10_000))
@settings(max_examples=examples(8), deadline=None)
def test_splats_end_in_time_though_their_motion_never_comes(seed: int) -> None:
    library = moving_library(f"memory://{uuid.uuid4().hex}", seed)
    viewer = Viewer(library, seed - seed % 2, "utility")

    def still(each: ev.Outgoing) -> bool:
        message = each.message
        return not (
            isinstance(message, TileLayers) and library.entry(message.frame).tiles[message.tile].kind == TileKind.MOTION
        )

    first = {key for key in viewer.client.held if library.entry(key[0]).tiles[key[1]].kind == TileKind.MOTION}
    for key in first:
        del viewer.client.held[key]
        viewer.streamer.on_event(ev.Evicted((InventoryEntry(*key, 0),)), viewer.now_us)
    lost: list[int] = []
    while (frame := viewer.step(delivers=still)) is not None:
        alive = np.flatnonzero(library.owners(frame) >= 0)
        lost += [int(i) for i in np.setdiff1d(viewer.client.shown(frame)[0], alive)]
    assert lost == []
