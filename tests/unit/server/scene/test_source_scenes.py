import threading

import numpy as np
import pytest

from cags_common.bundle import SourceDelta
from cags_common.bundle.source import decode_source, encode_source
from cags_common.errors import BundleError, DecodeError
from cags_common.raster import RenderOptions, create
from cags_server.scene.source_scenes import ABSENT_LOGIT, IDLE_SCENES, SourceScenes, _rolled
from support.raster_scenes import camera, random_splats
from support.server_scene import FakeReader, FakeScene


class Renderer:
    """Counts how often splats are loaded."""

    name = "counting"

    def __init__(self) -> None:
        self.loads = 0

    def load(self, splats):
        self.loads += 1
        return FakeScene(splats)


def depth_of(scene: FakeScene, row: int) -> float:
    return float(scene._splats.means[row, 2])


def test_a_scene_rolls_forward_without_being_loaded_again() -> None:
    renderer = Renderer()
    scenes = SourceScenes(FakeReader(), renderer)
    for frame in range(6):
        with scenes.at(frame) as scene:
            assert depth_of(scene, 0) == pytest.approx(3 + 0.01 * frame)
    assert renderer.loads == 1


def test_going_back_or_to_another_group_loads_anew() -> None:
    renderer = Renderer()
    scenes = SourceScenes(FakeReader(), renderer)
    for frame in (3, 1, 7):
        with scenes.at(frame):
            pass
    assert renderer.loads == 3


def test_two_users_of_one_frame_share_and_of_two_frames_do_not() -> None:
    renderer = Renderer()
    scenes = SourceScenes(FakeReader(), renderer)
    with scenes.at(1) as one, scenes.at(1) as same, scenes.at(2) as other:
        assert one is same
        assert other is not one
        assert depth_of(one, 0) == pytest.approx(3.01)
    assert renderer.loads == 2


def test_frames_that_change_nothing_share_one_scene() -> None:
    class Still(FakeReader):
        def source_delta(self, frame):
            delta = super().source_delta(frame)
            if frame in self.manifest.gof_starts:
                return delta
            return type(delta)(delta.ids[:0], delta.splats.take(slice(0, 0)), delta.removed[:0])

    renderer = Renderer()
    scenes = SourceScenes(Still(), renderer)
    with scenes.at(1) as one, scenes.at(5) as five:
        assert one is five


def test_removed_splats_are_transparent() -> None:
    scenes = SourceScenes(FakeReader(), Renderer())
    with scenes.at(1):
        pass
    with scenes.at(2) as scene:
        assert scene._splats.logit_opacities[39] < -10
        assert scene._splats.logit_opacities[38] > 0


def test_what_changed_lately_is_found_as_of_its_last_change_and_what_a_group_begins_with_is_not() -> None:
    reader = FakeReader()
    scenes = SourceScenes(reader, Renderer())
    wanted = np.zeros(reader.manifest.capacity[0], bool)
    wanted[[0, 5]] = True
    assert len(scenes.changed(0, wanted)) == 0
    for frame in (1, 4):
        found, truth = scenes.changed(frame, wanted), reader.source(frame)
        moved = [row for row, who in enumerate(truth.ids) if wanted[who] and who in reader.source_delta(frame).ids]
        assert moved
        np.testing.assert_array_equal(found.means[: len(moved)], truth.splats.means[moved])
        assert len(found) == len(moved), "each once"
    assert wanted.sum() == 2, "the caller's mask is not changed"


def test_idle_scenes_are_bounded() -> None:
    scenes = SourceScenes(FakeReader(frames=40, gof=2), Renderer())
    for frame in range(0, 40, 2):
        with scenes.at(frame):
            pass
    assert len(scenes) <= IDLE_SCENES


@pytest.mark.parametrize(("goal", "unreadable"), [(2, 0), (2, 1), (9, 9)])
def test_a_frame_that_cannot_be_read_leaves_nothing_half_loaded(goal, unreadable) -> None:
    class Broken(FakeReader):
        fail = True

        def source(self, frame):
            self.refuse(frame)
            return super().source(frame)

        def source_delta(self, frame):
            self.refuse(frame)
            return super().source_delta(frame)

        def refuse(self, frame):
            if self.fail and frame == unreadable:
                raise BundleError("gof_0000.bin: cut short")

    reader = Broken(frames=12, gof=12)
    scenes = SourceScenes(reader, Renderer())
    with pytest.raises(BundleError), scenes.at(goal):
        pass
    assert len(scenes) == 0
    reader.fail = False
    with scenes.at(goal) as scene:
        assert depth_of(scene, 0) == pytest.approx(3 + goal / 100)


def test_a_loop_reads_its_first_frames_once() -> None:
    class Counting(FakeReader):
        def __init__(self):
            super().__init__(frames=12, gof=12)
            self.read = []

        def source_delta(self, frame):
            self.read.append(frame)
            return super().source_delta(frame)

        def source(self, frame):
            self.read.append(frame)
            return super().source(frame)

    reader = Counting()
    scenes = SourceScenes(reader, Renderer())
    for frame in (1, 11, 1, 11, 2):
        with scenes.at(frame) as scene:
            assert depth_of(scene, 0) == pytest.approx(3 + frame / 100)
    assert len(reader.read) == len(set(reader.read))


def test_many_threads_see_their_own_frame() -> None:
    scenes = SourceScenes(FakeReader(frames=12, gof=12), Renderer())
    wrong: list[int] = []

    def watch(start: int) -> None:
        rng = np.random.default_rng(start)
        for frame in sorted(rng.integers(0, 12, 30).tolist()):
            with scenes.at(frame) as scene:
                if abs(depth_of(scene, 0) - (3 + 0.01 * frame)) > 1e-5:
                    wrong.append(frame)

    threads = [threading.Thread(target=watch, args=(i,)) for i in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert wrong == []


class Moving(FakeReader):
    """Splats 5 to 14 move and keep their looks."""

    which = np.arange(5, 15, dtype=np.int32)

    def source_delta(self, frame):
        if frame in self.manifest.gof_starts:
            return super().source_delta(frame)
        truth = self.source(frame)
        delta = SourceDelta(self.which, truth.splats.take(self.which), self.removed_ids(frame))
        return delta.keeping(np.ones(len(self.which), bool))


class Watched(FakeScene):
    """Refuses to replace whole splats."""

    def update(self, rows, splats, threads=1):
        raise AssertionError("splats that keep their looks are moved")


def test_what_keeps_its_looks_is_moved_and_not_replaced() -> None:
    reader, renderer = Moving(), Renderer()
    renderer.load = Watched
    scenes = SourceScenes(reader, renderer)
    wanted = np.zeros(reader.manifest.capacity[0], bool)
    wanted[[0, 6]] = True
    for frame in (0, 1, 2, 3):
        with scenes.at(frame) as scene:
            truth = reader.source(frame).splats
            np.testing.assert_array_equal(scene._splats.means[5:15], truth.means[5:15])
            np.testing.assert_array_equal(scene._splats.sh0[5:15], truth.sh0[5:15])
            assert (scene._splats.logit_opacities[39] < -10) == (frame >= 2)
        found = scenes.changed(frame, wanted)
        np.testing.assert_array_equal(found.means, truth.means[6:7] if frame else truth.means[:0])


def successive(frames: int, random: np.random.Generator) -> list[SourceDelta]:
    """Changes of a group of 40 splats, packed: some appear, some go, many move; the first holds everything."""
    alive, deltas = np.ones(40, bool), []
    for frame in range(frames):
        went = np.flatnonzero(alive & (random.random(40) < 0.2 * (frame > 0)))
        alive[went] = False
        came = np.flatnonzero(~alive & (random.random(40) < 0.5)) if frame else np.arange(40)
        alive[came] = True
        moving = np.setdiff1d(np.flatnonzero(alive & (random.random(40) < 0.8)), came) if frame else came[:0]
        ids = np.union1d(came, moving)
        delta = SourceDelta(ids.astype(np.int32), random_splats(len(ids), seed=frame), went.astype(np.int32))
        deltas.append(decode_source(encode_source(delta.keeping(np.isin(ids, moving))), "x"))
    return deltas


@pytest.mark.parametrize("seed", range(4))
def test_frames_passed_over_leave_what_one_after_the_other_does(seed: int) -> None:
    first, *rest = successive(6, np.random.default_rng(seed))
    one, other = first.splats.take(np.arange(40)), first.splats.take(np.arange(40))
    scene, stepped = create("cpu").load(one), create("cpu").load(other)
    moved, updated = _rolled(one, rest)
    scene.move(moved, one)
    scene.update(updated, one)
    for delta in rest:
        moved, updated = _rolled(other, [delta])
        stepped.move(moved, other)
        stepped.update(updated, other)
    assert np.array_equal(one.logit_opacities, other.logit_opacities)
    there = one.logit_opacities > ABSENT_LOGIT
    assert 0 < there.sum() < 40
    for (_, a), (_, b) in zip(one.arrays(), other.arrays(), strict=True):
        np.testing.assert_array_equal(a[there], b[there])
    views = [each.render(camera(), RenderOptions()).rgb for each in (scene, stepped)]
    np.testing.assert_array_equal(*views)
    assert views[0].max() > 0


def test_places_that_a_later_frame_replaces_are_not_unpacked() -> None:
    still = SourceDelta(np.arange(9, dtype=np.int32), random_splats(9), np.zeros(0, np.int32))
    deltas = [decode_source(encode_source(still.keeping(np.ones(9, bool))), "x") for _ in range(3)]
    damaged = bytearray(encode_source(still.keeping(np.ones(9, bool))))
    damaged[-20:] = bytes(20)
    deltas[1] = decode_source(bytes(damaged), "x")
    moved, updated = _rolled(random_splats(9), deltas)
    assert moved.tolist() == list(range(9)) and not len(updated)
    with pytest.raises(DecodeError):
        _rolled(random_splats(9), deltas[:2])
