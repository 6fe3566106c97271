"""From messages to pictures: a small clip, encoded here, decoded, drawn and corrected by the pipeline."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cags_client.frame import pipeline, restore
from cags_client.frame.pipeline import ClientPipeline
from cags_client.frame.restore import RestoreInput, expected_psnr_db
from cags_client.output.score import averages, score
from cags_client.playback.jobs import Decode
from cags_client.settings import ClientSettings
from cags_common.bundle import BundleReader
from cags_common.coding.packing import crc32
from cags_common.correction.reach import HOLDS, valid_share
from cags_common.errors import ConfigError, DecodeError
from cags_common.geometry import Camera, Pose, multiply_quaternions, quaternion_of_rotation_vector
from cags_common.metrics import psnr
from cags_common.raster.base import RasterScene, RenderedView, RenderOptions
from cags_encoder import EncodeSettings, encode
from cags_encoder.scenes import open_scene
from cags_protocol import events as ev
from cags_protocol.wire.messages import FrameEnd, Mark, ReferenceFrame, ReferenceKind, TileLayers
from support.client_stage import VIEW, Stage, walk
from support.small_motion import looks, motion, moving
from support.small_store import books

DIFFERENCE, PICTURE, NOTHING = ReferenceKind.DIFFERENCE, ReferenceKind.PICTURE, ReferenceKind.NOTHING


@pytest.fixture(scope="module")
def reader(tmp_path_factory: pytest.TempPathFactory) -> BundleReader:
    folder: Path = tmp_path_factory.mktemp("bundle") / "room"
    settings = EncodeSettings(frames=3, quantiser="paper-66", train_splats=4096)
    encode(open_scene("procedural:size=3000,frames=3"), settings, str(folder))
    return BundleReader.open(str(folder))


@pytest.mark.parametrize("kind", [DIFFERENCE, PICTURE])
def test_a_frame_is_corrected_towards_the_truth(reader: BundleReader, kind: ReferenceKind) -> None:
    stage, pose = Stage(reader), walk(reader)
    stage.send(0)
    stage.refer(0, pose, kind)
    shown, true = stage.show(0, pose), stage.truth(0, pose)
    scores = score(shown, true, np.ones((120, 160), np.float32))
    assert scores["psnr_restored_db"] > scores["psnr_distorted_db"] + 1
    assert scores["psnr_restored_db"] == pytest.approx(psnr(shown.rgb, true))
    assert not shown.missed
    assert shown.lod_mean == 0
    assert averages([scores, scores])["psnr_restored_db"] == pytest.approx(scores["psnr_restored_db"])


def test_a_coarse_picture_of_an_earlier_frame_takes_nothing_from_splats_that_are_better(tmp_path: Path) -> None:
    """At the beginning of a play beside other work, 55 dB became 33."""
    settings = EncodeSettings(frames=36, quantiser="paper-66", train_splats=2048)
    encode(open_scene("procedural:size=1500,frames=36"), settings, str(tmp_path / "room"))
    stage = Stage(BundleReader.open(str(tmp_path / "room")))
    pose = walk(stage.reader)
    for frame in range(9):
        stage.send(frame, stage.reader.manifest.lods)
    message, unit = stage.reference(0, pose, PICTURE, crf=41)
    assert message.error > 1e-4
    assert stage.pipe.on_reference(message, memoryview(unit))
    shown, true = stage.show(8, pose), stage.truth(8, pose)  # until then nothing could be drawn
    assert shown.reference is not None
    assert psnr(shown.rgb, true) > psnr(shown.distorted, true) - 0.02


def test_without_a_reference_the_distorted_picture_is_shown(reader: BundleReader) -> None:
    stage, pose = Stage(reader), walk(reader)
    stage.send(0)
    shown = stage.show(0, pose)
    assert shown.aligned is shown.confidence is shown.reference is None
    np.testing.assert_array_equal(shown.rgb, shown.distorted)


def test_a_reference_that_says_nothing_changes_nothing(reader: BundleReader) -> None:
    stage, pose = Stage(reader), walk(reader)
    stage.send(0, reader.manifest.lods)
    stage.refer(0, pose, NOTHING)
    shown = stage.show(0, pose)
    assert shown.reference is not None
    assert shown.lod_mean == reader.manifest.lods - 1
    np.testing.assert_array_equal(shown.rgb, shown.distorted)


def test_a_restorer_that_replaces_the_picture_does_so_at_the_top_too(reader: BundleReader) -> None:
    stage, pose = Stage(reader, restore="reference"), walk(reader)
    stage.send(0, reader.manifest.lods)
    stage.refer(0, pose, PICTURE)
    shown = stage.show(0, pose)
    assert shown.aligned is not None
    assert not np.array_equal(shown.rgb, shown.distorted)


def test_a_restorer_is_told_the_psnr_expected_of_what_is_on_screen(
    reader: BundleReader, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[float] = []
    plain = restore.create("reference")

    class Listening:
        name, needs, replaces = "reference", plain.needs, True

        def restore(self, inputs: RestoreInput) -> np.ndarray:
            told.append(inputs.expected_db)
            return plain.restore(inputs)

    monkeypatch.setattr(restore, "create", lambda name, **_: Listening())
    pose, top = walk(reader), reader.manifest.lods - 1
    for lod in (0, top // 3, top):
        stage = Stage(reader, restore="reference")
        stage.send(0, lod + 1)
        stage.refer(0, pose, PICTURE)
        stage.show(0, pose)
        assert told.pop() == pytest.approx(expected_psnr_db(lod, reader.manifest))
    assert not told


@pytest.mark.parametrize(("restorer", "kind"), [("correct", DIFFERENCE), ("correct", PICTURE), ("reference", PICTURE)])
def test_an_old_reference_fades_and_a_very_old_one_is_not_used(
    reader: BundleReader, restorer: str, kind: ReferenceKind
) -> None:
    """Of a still picture, so that nothing else takes from what the reference says."""
    pose = walk(reader)
    stage, strict = (Stage(reader, restore=restorer, reference_age=age) for age in (2, 1))
    for each in (stage, strict):
        each.send(0)
        each.refer(0, pose, kind)
    most = []
    for frame in range(3):
        for each in (stage, strict) if frame else ():
            each.end(frame)
        confidence = stage.show(frame, pose).confidence
        assert confidence is not None
        most.append(confidence.max())
        shown = strict.show(frame, pose)
    assert most[1] == most[0] > 0
    assert most[2] == pytest.approx(most[0] * 2 / 3)
    assert shown.confidence is None


@pytest.mark.parametrize(("restorer", "kind"), [("correct", DIFFERENCE), ("correct", PICTURE), ("reference", PICTURE)])
def test_less_of_a_difference_is_used_from_farther_away(
    reader: BundleReader, restorer: str, kind: ReferenceKind
) -> None:
    """Pictures are compared with what is shown, or stand for it, and methods of others are as their authors say."""
    pose = walk(reader)
    stage = Stage(reader, restore=restorer)
    stage.send(0)
    stage.refer(0, pose, kind)
    for angle in (0.0, 0.1, 0.4, 0.8):
        turn = quaternion_of_rotation_vector((0.0, 0.0, angle))
        shown = stage.show(0, Pose(pose.position, multiply_quaternions(pose.rotation, turn)))
        used = 0.0 if shown.confidence is None else shown.confidence.max()
        assert used == pytest.approx(valid_share(angle, HOLDS) if kind is DIFFERENCE else 1.0)


def test_a_reference_of_a_frame_to_come_is_not_used(reader: BundleReader) -> None:
    stage, pose = Stage(reader), walk(reader)
    stage.send(0)
    stage.show(0, pose)
    stage.send(1)
    stage.refer(1, pose)
    assert stage.show(0, pose).reference is None
    shown = stage.show(1, pose)
    assert shown.reference is not None
    assert not np.array_equal(shown.rgb, shown.distorted)


def test_what_comes_after_a_mark_waits_for_the_next_reference(reader: BundleReader) -> None:
    """A difference is right for the splats that it was taken from, and for those alone."""
    plain, stage, pose = Stage(reader), Stage(reader), walk(reader)
    for each in (plain, stage):
        each.send(0)
        each.refer(0, pose)
    stage.send(0, reader.manifest.lods, first=1)
    early, same = stage.show(0, pose), plain.show(0, pose)
    np.testing.assert_array_equal(early.rgb, same.rgb)
    assert early.lod_mean == 0
    stage.send(1, reader.manifest.lods)
    stage.refer(1, pose)
    assert stage.show(1, pose).lod_mean > 0


def waiting_for_a_reference(reader: BundleReader) -> tuple[Stage, Pose]:
    """Frame 0 was shown at its base level; all levels of both frames have come, and no reference of frame 1."""
    stage, pose = Stage(reader), walk(reader)
    stage.send(0)
    stage.refer(0, pose)
    stage.show(0, pose)
    stage.send(0, reader.manifest.lods, first=1)
    stage.send(1, reader.manifest.lods)
    return stage, pose


def test_while_a_reference_is_late_what_is_shown_stays_and_not_for_ever(
    reader: BundleReader, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pipeline, "PATIENCE_FRAMES", 1)
    stage, pose = waiting_for_a_reference(reader)
    stage.mark()
    assert stage.show(1, pose).lod_mean == 0, "as the reference before assumes"
    assert stage.show(2, pose).lod_mean > 0


def test_a_reference_that_came_after_its_frame_is_shown_with_what_it_assumes(reader: BundleReader) -> None:
    """On a slow link or beside a slow server each reference may come a frame late."""
    stage, pose = waiting_for_a_reference(reader)
    assert stage.show(1, pose).lod_mean == 0
    stage.refer(1, pose)
    shown = stage.show(2, pose)
    assert shown.reference is not None
    assert shown.reference.frame == 1
    assert shown.lod_mean > 0


def test_while_a_reference_is_late_one_that_says_nothing_holds_nothing_back(reader: BundleReader) -> None:
    """The demo's fourth frame stood still at its start, for a reference without content."""
    stage, pose = Stage(reader), walk(reader)
    stage.send(0)
    stage.refer(0, pose, NOTHING)
    assert stage.show(0, pose).lod_mean == 0
    stage.send(0, reader.manifest.lods, first=1)
    stage.send(1, reader.manifest.lods)
    stage.mark()
    shown = stage.show(1, pose)
    assert not shown.missed
    assert shown.lod_mean > 0


class CountingScene:
    """Counts how often a scene is drawn from a reference's camera."""

    def __init__(self, scene: RasterScene) -> None:
        self.scene, self.drawn = scene, 0

    def render(self, camera: Camera, options: RenderOptions) -> RenderedView:
        self.drawn += camera.width_px == VIEW.width_px
        return self.scene.render(camera, options)

    def __getattr__(self, name: str) -> object:
        return getattr(self.scene, name)


@pytest.mark.parametrize(("kind", "counted"), [(PICTURE, [0, 1, 1, 1, 2]), (DIFFERENCE, [0, 0, 0, 0, 0])])
def test_the_reference_render_is_drawn_for_a_picture_when_looks_change_and_never_for_a_difference(
    reader: BundleReader, kind: ReferenceKind, counted: list[int]
) -> None:
    stage, pose = Stage(reader), walk(reader)
    stage.send(0)
    counts = []
    for number, frame in enumerate((0, 0, 0, 1, 2)):
        if number and frame:
            stage.send(frame)
        if number in (1, 4):
            stage.refer(frame, pose, kind)
        stage.show(frame, pose)
        if not isinstance(stage.pipe._scene, CountingScene):
            assert stage.pipe._scene is not None
            counter = CountingScene(stage.pipe._scene)
            stage.pipe._scene = counter  # type: ignore[assignment]
        counts.append(counter.drawn)
    assert counts == counted


def test_a_frame_that_did_not_come_shows_the_looks_of_the_one_before_and_their_motion_goes_on(
    reader: BundleReader,
) -> None:
    stage, pose = Stage(reader), walk(reader)
    stage.send(0)
    stage.show(0, pose)
    assert stage.pipe.on_display is not None
    splats = stage.pipe.on_display.splats
    before = splats.take(slice(None))
    before = replace(before, **{name: column.copy() for name, column in before.arrays()})
    assert stage.show(1, pose).missed
    for name in ("log_scales", "sh0", "sh_rest"):
        np.testing.assert_array_equal(getattr(splats, name), getattr(before, name))
    assert (splats.means != before.means).any()
    stage.send(1)
    assert not stage.show(1, pose).missed


@pytest.mark.parametrize("kind", [DIFFERENCE, PICTURE])
def test_what_has_not_come_is_put_in_by_the_reference(reader: BundleReader, kind: ReferenceKind) -> None:
    """Every other tile of the first frame is missing: the server knows, and the reference says what they would show."""
    stage, pose = Stage(reader), walk(reader)
    stage.send(0, every=2)
    stage.refer(0, pose, kind)
    shown, true = stage.show(0, pose), stage.truth(0, pose)
    assert psnr(shown.rgb, true) >= psnr(shown.distorted, true) + 5
    assert np.isfinite(shown.rgb).all()
    assert 0 <= shown.rgb.min() <= shown.rgb.max() <= 1


def test_a_damaged_reference_asks_for_an_idr_and_is_not_shown(reader: BundleReader) -> None:
    stage, pose = Stage(reader), walk(reader)
    stage.send(0)
    message, _ = stage.reference(0, pose)
    with pytest.raises(DecodeError):
        stage.pipe.on_reference(message, memoryview(b"\x00" * 40))
    late = ReferenceFrame(1, 3, pose, VIEW, idr=False)
    assert not stage.pipe.on_reference(late, memoryview(b"\x00\x00\x01\x41\x9a"))
    assert stage.show(0, pose).reference is None
    assert stage.pipe.last_reference_seq == 0


def test_after_a_jump_that_forgets_the_mark_begins_anew(reader: BundleReader) -> None:
    stage, pose = Stage(reader), walk(reader)
    stage.send(0)
    stage.refer(0, pose)
    stage.show(0, pose)
    stage.pipe.reset(0)
    stage.pipe.on_mark(Mark(2, restart=True))
    assert stage.pipe.held() == []
    assert stage.show(0, pose).reference is None


def test_over_another_connection_marks_count_on_from_what_is_held(reader: BundleReader) -> None:
    stage, pose = Stage(reader), walk(reader)
    stage.send(0)
    stage.refer(0, pose)
    stage.show(0, pose)
    stage.pipe.restarted(stage.pipe.held())
    other = Stage(reader)
    other.pipe = stage.pipe
    other.send(0)  # what is held comes to the other server by the inventory; here it comes twice
    other.refer(0, pose)
    shown = other.show(0, pose)
    assert shown.reference is not None
    assert shown.reference.basis == 2, "one mark of either connection"
    assert psnr(shown.rgb, stage.truth(0, pose)) > psnr(shown.distorted, stage.truth(0, pose)) + 1


def test_unknown_restorers_are_named(reader: BundleReader) -> None:
    with pytest.raises(ConfigError, match="magic"):
        Stage(reader, restore="magic")


def test_the_end_of_a_frame_that_the_clip_does_not_have_is_reported_like_any_damage(reader: BundleReader) -> None:
    stage = Stage(reader, restore="none")
    ends = [ev.FrameEnded(FrameEnd(frame), memoryview(b"")) for frame in (2**31 - 1, 0)]
    result = Decode(tuple(ends), stage.pipe).run()
    assert [str(error) for error in result.errors] == ["frame 2147483647 is outside the clip's 3 frames"]
    assert result.whole == 0


@pytest.mark.parametrize("size", [(160, 120), (161, 119)])
def test_at_half_resolution_a_frame_is_corrected_and_everything_looked_at_is_whole(
    reader: BundleReader, size: tuple[int, int]
) -> None:
    width, height = size
    scores = {}
    for resolution in ("full", "half"):
        stage, pose = Stage(reader, width=width, height=height, resolution=resolution), walk(reader)
        stage.send(0)
        stage.refer(0, pose)
        shown, true = stage.show(0, pose), stage.truth(0, pose)
        scores[resolution] = score(shown, true, np.ones((height, width), np.float32))
        assert shown.rgb.shape == shown.distorted.shape == (height, width, 3)
        assert shown.rgb.min() >= 0
        assert shown.rgb.max() <= 1
    assert shown.drawn.shape == ((height + 1) // 2, (width + 1) // 2, 3)
    assert "enlarge" in shown.stages_ms
    assert scores["half"]["psnr_restored_db"] > scores["half"]["psnr_distorted_db"] + 1
    assert abs(scores["half"]["psnr_distorted_db"] - scores["full"]["psnr_distorted_db"]) < 1.5


def moving_pipeline(**settings: object) -> ClientPipeline:
    """A splat that moves by a metre a frame, and one that stands still; all of it has come."""
    of = moving()
    made = ClientSettings(**{"width": 160, "height": 120, **settings})  # type: ignore[arg-type]
    pipe = ClientPipeline(of, made)
    pipe.on_codebooks(books().to_bytes())
    for tile, payloads in enumerate((looks([0], 5), looks([1], 9), motion((0, 0), 1, [0, 1, 2, 3]))):
        parts = payloads.payloads
        message = TileLayers(0, tile, 0, len(parts), tuple(map(len, parts)), tuple(map(crc32, parts)))
        assert pipe.on_tiles([(message, memoryview(b"".join(parts)))]) == []
    for frame in range(4):
        pipe.on_frame_end(FrameEnd(frame), memoryview(b""))
    return pipe


MOVING_VIEW = Pose.looking_at((7, 7, -30), (7, 5, 5))


def test_what_moves_is_drawn_between_frames_and_the_next_frame_as_if_it_had_not_been() -> None:
    pipe, plain = moving_pipeline(), moving_pipeline()
    camera = pipe.camera(MOVING_VIEW)
    pipe.present(0, camera)
    between = pipe.present(0, camera, 0.5)
    assert (between.frame, between.share) == (0, 0.5)
    assert pipe.on_display is not None
    assert pipe.on_display.splats.means[:2, 0].tolist() == [5.5, 9]
    assert not between.missed
    whole = plain.present(0, camera)
    assert not np.array_equal(between.rgb, whole.rgb)
    np.testing.assert_array_equal(pipe.present(1, camera).rgb, plain.present(1, camera).rgb)
    np.testing.assert_array_equal(pipe.present(1, camera).rgb, plain.present(1, camera).rgb)  # a frame again


def test_between_frames_of_nothing_that_was_shown_the_frame_itself_is() -> None:
    pipe, plain = moving_pipeline(), moving_pipeline()
    camera = pipe.camera(MOVING_VIEW)
    np.testing.assert_array_equal(pipe.present(1, camera, 0.5).rgb, plain.present(1, camera).rgb)
