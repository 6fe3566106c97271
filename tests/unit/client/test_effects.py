"""Effects of a client's frame: left out they change nothing, needed they are on, taken away they are missed."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cags_client import align, pipeline
from cags_client.align import Aligned, ReferencePicture
from cags_client.pipeline import ClientPipeline
from cags_client.presented import PresentedFrame
from cags_client.settings import ClientSettings
from cags_common import raster
from cags_common.bundle import BundleReader
from cags_common.effects import ALWAYS, POLICIES, Effect, EffectPlan, Situation, plan_frame
from cags_common.geometry import Camera, Intrinsics, Pose
from cags_common.metrics import psnr
from cags_common.packing import encode_ids
from cags_common.poses import Focus, synthetic_walk
from cags_common.raster.base import Footprint, RenderOptions
from cags_common.splats import SH_REST_OF_DEGREE
from cags_common.video.colour import Chroma
from cags_common.video.h264 import H264Decoder, H264Encoder
from cags_common.video.noise import coding_noise
from cags_encoder import EncodeSettings, encode
from cags_encoder.scenes import open_scene
from cags_protocol.messages import FrameEnd, ReferenceFrame, TileLayers

VIEW = Intrinsics.of_fov(80, 60, 1.3, 1.1)


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


class Stage:
    """A pipeline, and what it is sent."""

    def __init__(self, reader: BundleReader, **settings: object) -> None:
        self.reader = reader
        client = ClientSettings(width=160, height=120, **settings)  # type: ignore[arg-type]
        self.pipe = ClientPipeline(reader.manifest, reader.codebooks(), client)
        self.seq = 0

    def send(self, frame: int, lods: int = 1) -> None:
        for entry in self.reader.frame(frame).tiles:
            levels = min(lods, len(entry.lod_bytes))
            parts = [self.reader.payload(frame, entry.tile, lod) for lod in range(levels)]
            message = TileLayers(frame, entry.tile, 0, levels, tuple(map(len, parts)), entry.crcs[:levels])
            assert self.pipe.on_tiles([(message, memoryview(b"".join(parts)))]) == []
        self.pipe.on_frame_end(FrameEnd(frame), memoryview(self.reader.removed_payload(frame)))

    def refer(self, frame: int, pose: Pose) -> None:
        self.seq += 1
        camera = Camera(VIEW, pose, self.reader.manifest.near)
        scene = raster.create("auto").load(self.reader.source(frame).splats)
        options = RenderOptions(footprint=Footprint.of(self.pipe.settings.intrinsics, VIEW))
        rgb = scene.render(camera, options).rgb.clip(0, 1)
        unit = H264Encoder(80, 60, 30, chroma=Chroma.FULL).encode(rgb, idr=True)
        decoded = H264Decoder().decode(unit)
        assert decoded is not None
        noise = coding_noise(rgb, decoded).packed()
        self.pipe.on_reference(ReferenceFrame(frame, self.seq, pose, VIEW, True, noise), memoryview(unit))

    def show(self, frame: int, pose: Pose) -> PresentedFrame:
        return self.pipe.present(frame, self.pipe.camera(pose))

    def truth(self, frame: int, pose: Pose) -> np.ndarray:
        scene = raster.create("auto").load(self.reader.source(frame).splats)
        return scene.render(self.pipe.camera(pose), RenderOptions()).rgb.clip(0, 1)


def walk(reader: BundleReader, t_us: int) -> Pose:
    m = reader.manifest
    return synthetic_walk("walking", Focus(m.focus_centre, m.focus_radius, m.up), duration_s=2).pose_at(t_us)


def turned(pose: Pose, other: Pose) -> Pose:
    """Looks as ``other`` does from where ``pose`` stands."""
    return Pose(pose.position, other.rotation)


def moving_parallax(stage: Stage) -> list[PresentedFrame]:
    here, there = walk(stage.reader, 1_400_000), walk(stage.reader, 1_300_000)
    stage.send(0)
    stage.refer(0, there)
    first = stage.show(0, here)
    stage.send(1, 2)
    return [first, stage.show(1, here)]


def turning_on_the_spot(stage: Stage) -> list[PresentedFrame]:
    here, there = walk(stage.reader, 1_400_000), walk(stage.reader, 1_000_000)
    stage.send(0)
    stage.refer(0, turned(here, there))
    return [stage.show(0, here)]


def all_there(stage: Stage) -> list[PresentedFrame]:
    here = walk(stage.reader, 1_400_000)
    stage.send(0, stage.reader.manifest.lods)
    stage.refer(0, walk(stage.reader, 1_300_000))
    return [stage.show(0, here), stage.show(0, here)]


def torn(stage: Stage) -> list[PresentedFrame]:
    """The splats of the left of the view are gone, but the reference shows them."""
    here = walk(stage.reader, 1_400_000)
    stage.send(0, 2)
    stage.show(0, here)
    source = stage.reader.source(0)
    left = (source.splats.means - np.asarray(here.position)) @ here.rotation_matrix[:, 0] < 0
    gone = np.sort(source.ids[left])
    stage.pipe.on_frame_end(FrameEnd(1), memoryview(encode_ids(gone)))
    stage.refer(1, walk(stage.reader, 1_300_000))
    return [stage.show(1, here)]


def nothing_to_look_at(stage: Stage) -> list[PresentedFrame]:
    stage.send(0)
    return [stage.show(0, walk(stage.reader, 1_400_000))]


SCRIPTS = [moving_parallax, turning_on_the_spot, nothing_to_look_at]


@pytest.mark.parametrize("restorer", ["affine", "reference", "none"])
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


def test_at_the_highest_level_restoration_is_left_out_and_would_do_no_harm(tmp_path: Path) -> None:
    scene = open_scene("procedural:size=20000,frames=1")
    encode(scene, EncodeSettings(frames=1, train_splats=4096), str(tmp_path / "fine"))
    reader = BundleReader.open(str(tmp_path / "fine"))
    stages = [Stage(reader, effects=policy) for policy in POLICIES]
    needed, always = (all_there(stage)[0] for stage in stages)
    assert Effect.ALIGNMENT not in needed.effects
    assert Effect.ALIGNMENT in always.effects
    truth = stages[0].truth(0, walk(reader, 1_400_000))
    assert psnr(always.rgb, truth) >= psnr(needed.rgb, truth) - 0.1
    np.testing.assert_array_equal(needed.rgb, needed.distorted)


def test_what_is_on_follows_the_moment(reader: BundleReader, degree: int) -> None:
    view = {Effect.VIEW_COLOUR} if degree else set()
    first, second = (set(f.effects.on) for f in moving_parallax(Stage(reader)))
    restoring = {Effect.RESTORATION, Effect.ALIGNMENT, Effect.OCCLUSION, Effect.OWN_VIEW, Effect.STAND_IN}
    usual = restoring | {Effect.DEPTH}
    assert first == usual | view | {Effect.DELTAS}
    assert second == usual | view | {Effect.DELTAS, Effect.FADE, Effect.CARRY}
    assert set(turning_on_the_spot(Stage(reader))[0].effects.on) == (usual - {Effect.OCCLUSION}) | view | {
        Effect.DELTAS
    }
    first, second = (set(f.effects.on) for f in all_there(Stage(reader)))
    assert first == view | {Effect.DELTAS}
    assert second == view
    assert Effect.EROSION in moving_parallax(Stage(reader, restore="reference"))[0].effects
    assert all_there(Stage(reader))[0].depth is None


Planner = Callable[[Situation, str], EffectPlan]


def quality(stage: Stage, script: Callable[[Stage], list[PresentedFrame]]) -> float:
    first = script(stage)[0]
    return psnr(first.rgb, stage.truth(first.frame, first.camera.pose))


@pytest.mark.parametrize(
    ("effect", "script", "settings", "loss_db"),
    [
        (Effect.RESTORATION, moving_parallax, {}, 1.0),
        (Effect.ALIGNMENT, moving_parallax, {}, 1.0),
        (Effect.OWN_VIEW, turning_on_the_spot, {}, 0.01),
        (Effect.DEPTH, moving_parallax, {}, 1.0),
        (Effect.STAND_IN, torn, {}, 2.0),
    ],
)
def test_a_scene_that_needs_an_effect_shows_its_absence(
    reader: BundleReader,
    monkeypatch: pytest.MonkeyPatch,
    effect: Effect,
    script: Callable[[Stage], list[PresentedFrame]],
    settings: dict[str, object],
    loss_db: float,
) -> None:
    whole = quality(Stage(reader, **settings), script)
    monkeypatch.setattr(pipeline, "plan_frame", lambda s, policy: plan_frame(s, policy).without(effect))
    assert quality(Stage(reader, **settings), script) < whole - loss_db


def test_glossy_splats_need_view_dependent_colour(
    reader: BundleReader, degree: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = quality(Stage(reader), all_there)
    monkeypatch.setattr(pipeline, "plan_frame", lambda s, policy: plan_frame(s, policy).without(Effect.VIEW_COLOUR))
    flat = quality(Stage(reader), all_there)
    assert flat < whole - 1 if degree else flat == whole


@pytest.mark.parametrize("name", ["cpu", "fast", "reference"])
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
