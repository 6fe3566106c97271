"""Effects of a client's frame: left out they change nothing, needed they are on, taken away they are missed."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cags_client.frame import align, pipeline
from cags_client.frame.align import Aligned, ReferencePicture
from cags_client.frame.presented import PresentedFrame
from cags_common.bundle import BundleReader
from cags_common.geometry import Camera, Intrinsics, Pose
from cags_common.metrics import psnr
from cags_common.passes import ALWAYS, Pass, PassPlan, Situation, plan_frame
from cags_common.splats import SH_REST_OF_DEGREE
from cags_encoder import EncodeSettings, encode
from cags_encoder.scenes import open_scene
from cags_protocol.wire.messages import ReferenceKind
from support.client_stage import Stage, walk

PICTURE = ReferenceKind.PICTURE


@pytest.fixture(scope="module", params=[0, 2], ids=["flat", "glossy"])
def degree(request: pytest.FixtureRequest) -> int:
    return int(request.param)


@pytest.fixture(scope="module")
def reader(tmp_path_factory: pytest.TempPathFactory, degree: int) -> BundleReader:
    folder: Path = tmp_path_factory.mktemp("bundle") / "room"
    settings = EncodeSettings(frames=2, quantiser="paper-66", train_splats=2048, lod_order="paper")
    scene = open_scene("procedural:size=3000,frames=2")
    whole, rest = scene.frame, SH_REST_OF_DEGREE[degree]
    monkeypatch = pytest.MonkeyPatch()
    monkeypatch.setattr(type(scene), "frame", lambda _, i: replace(whole(i), sh_rest=whole(i).sh_rest[:, :rest]))
    encode(scene, settings, str(folder))
    monkeypatch.undo()
    return BundleReader.open(str(folder))


@pytest.fixture(autouse=True)
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """What has come is shown, whether or not its reference is late."""
    monkeypatch.setattr(pipeline, "PATIENCE_FRAMES", 0)


def turned(pose: Pose, other: Pose) -> Pose:
    """Looks as ``other`` does from where ``pose`` stands."""
    return Pose(pose.position, other.rotation)


def of_the_moment(stage: Stage) -> list[PresentedFrame]:
    """Frames with references of their own, seen from a little aside."""
    frames = []
    for frame in range(2):
        stage.send(frame)
        stage.refer(frame, walk(stage.reader, 1_300_000))
        frames.append(stage.show(frame, walk(stage.reader)))
    return frames


def of_a_picture(stage: Stage) -> list[PresentedFrame]:
    stage.send(0)
    stage.refer(0, walk(stage.reader, 1_300_000), PICTURE)
    first = stage.show(0, walk(stage.reader))
    stage.send(1, 2)
    return [first, stage.show(1, walk(stage.reader))]


def turning_on_the_spot(stage: Stage) -> list[PresentedFrame]:
    here = walk(stage.reader)
    stage.send(0)
    stage.refer(0, turned(here, walk(stage.reader, 1_000_000)), PICTURE)
    return [stage.show(0, here)]


def refined_since(stage: Stage) -> list[PresentedFrame]:
    """The next frame has no reference, and its splats are whole by then: what was lacking is not any more."""
    stage.send(0)
    stage.refer(0, walk(stage.reader))
    first = stage.show(0, walk(stage.reader))
    stage.send(0, stage.reader.manifest.lods, first=1)
    stage.send(1, stage.reader.manifest.lods)
    stage.mark()
    return [stage.show(1, walk(stage.reader)), first]


def all_there(stage: Stage) -> list[PresentedFrame]:
    here = walk(stage.reader)
    stage.send(0, stage.reader.manifest.lods)
    stage.refer(0, walk(stage.reader, 1_300_000), PICTURE)
    return [stage.show(0, here), stage.show(0, here)]


def nothing_to_look_at(stage: Stage) -> list[PresentedFrame]:
    stage.send(0)
    return [stage.show(0, walk(stage.reader))]


SCRIPTS = [of_the_moment, of_a_picture, turning_on_the_spot, refined_since, nothing_to_look_at]


@pytest.mark.parametrize("restorer", ["correct", "reference", "none"])
@pytest.mark.parametrize("script", SCRIPTS)
def test_leaving_out_what_is_not_needed_changes_nothing(
    reader: BundleReader, script: Callable[[Stage], list[PresentedFrame]], restorer: str
) -> None:
    needed = script(Stage(reader, restore=restorer))
    always = script(Stage(reader, restore=restorer, effects=ALWAYS))
    for a, b in zip(needed, always, strict=True):
        assert a.effects.on <= b.effects.on
        np.testing.assert_array_equal(a.rgb, b.rgb)
        np.testing.assert_array_equal(a.distorted, b.distorted)


def test_what_is_on_follows_the_moment(reader: BundleReader, degree: int) -> None:
    usual = {Pass.VIEW_COLOUR} if degree else set()
    correcting = usual | {Pass.CORRECTION, Pass.DEPTH}
    first, second = (set(f.effects.on) for f in of_the_moment(Stage(reader)))
    assert first == second == correcting
    first, second = (set(f.effects.on) for f in of_a_picture(Stage(reader)))
    assert first == correcting | {Pass.REFERENCE_RENDER}
    assert second == correcting | {Pass.REFERENCE_RENDER, Pass.VETO, Pass.FADE}
    assert set(nothing_to_look_at(Stage(reader))[0].effects.on) == usual
    assert nothing_to_look_at(Stage(reader))[0].depth is None


def test_what_is_on_for_restorers_follows_the_moment(reader: BundleReader, degree: int) -> None:
    usual = {Pass.VIEW_COLOUR} if degree else set()
    restoring = usual | {Pass.RESTORATION, Pass.ALIGNMENT, Pass.DEPTH}
    hidden = {Pass.OCCLUSION, Pass.EROSION}
    first, second = (set(f.effects.on) for f in of_a_picture(Stage(reader, restore="reference")))
    assert first == restoring | hidden
    assert second == restoring | hidden | {Pass.FADE}
    assert set(turning_on_the_spot(Stage(reader, restore="reference"))[0].effects.on) == restoring
    pytest.importorskip("torch")
    first, second = all_there(Stage(reader, restore="srresnet"))
    assert set(first.effects.on) == usual, "it puts colours right, and they are"
    assert set(second.effects.on) == usual
    np.testing.assert_array_equal(first.rgb, first.distorted)


Planner = Callable[[Situation, str], PassPlan]


def quality(stage: Stage, script: Callable[[Stage], list[PresentedFrame]]) -> float:
    first = script(stage)[0]
    return psnr(first.rgb, stage.truth(first.frame, first.camera.pose))


def without(plan: PassPlan, taken: Pass) -> PassPlan:
    """The plan less one pass: what a frame would lose."""
    return PassPlan(plan.on - {taken}, 0 if taken is Pass.VIEW_COLOUR else plan.sh_degree)


@pytest.mark.parametrize(
    ("effect", "script", "settings", "loss_db"),
    [
        (Pass.CORRECTION, of_the_moment, {}, 1.0),
        (Pass.CORRECTION, of_a_picture, {}, 1.0),
        (Pass.VETO, refined_since, {}, 3.0),
        (Pass.RESTORATION, of_a_picture, {"restore": "reference"}, 1.0),
        (Pass.DEPTH, of_a_picture, {"restore": "reference"}, 1.0),
    ],
)
def test_a_scene_that_needs_an_effect_shows_its_absence(
    reader: BundleReader,
    monkeypatch: pytest.MonkeyPatch,
    effect: Pass,
    script: Callable[[Stage], list[PresentedFrame]],
    settings: dict[str, object],
    loss_db: float,
) -> None:
    whole = quality(Stage(reader, **settings), script)
    monkeypatch.setattr(pipeline, "plan_frame", lambda s, policy: without(plan_frame(s, policy), effect))
    assert quality(Stage(reader, **settings), script) < whole - loss_db


def test_glossy_splats_need_view_dependent_colour(
    reader: BundleReader, degree: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = quality(Stage(reader, restore="none"), all_there)
    monkeypatch.setattr(pipeline, "plan_frame", lambda s, policy: without(plan_frame(s, policy), Pass.VIEW_COLOUR))
    flat = quality(Stage(reader, restore="none"), all_there)
    assert flat < whole - 1 if degree else flat == whole


@pytest.mark.parametrize("name", ["fast", "oracle"])
def test_what_hides_something_is_found_only_where_it_is_looked_for(name: str) -> None:
    """A near square before a far wall, seen from the side: pixels behind it in the reference are hidden."""
    seen, blind = (_past_an_edge(name, occlusion=occlusion) for occlusion in (True, False))
    assert seen.occluded.sum() > 20
    assert not blind.occluded.any()
    assert (blind.confidence > 0).sum() > (seen.confidence > 0).sum()
    assert np.abs(blind.rgb - seen.rgb).max() > 0.5, "without it the near colour lies on the far wall"


def _past_an_edge(name: str, *, occlusion: bool) -> Aligned:
    intrinsics = Intrinsics.of_fov(64, 48, 1.0, 0.8)
    depth = np.full((48, 64), 4.0, np.float32)
    depth[12:36, 20:44] = 1.0
    here = Camera(intrinsics, Pose.identity())
    there = here.at(Pose((0.4, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)))
    rgb = np.zeros((48, 64, 3), np.float32)
    rgb[12:36, 0:22] = 1.0  # the square where the other camera sees it
    return align.create(name).align(ReferencePicture(rgb, there, 0), depth, here, occlusion=occlusion)
