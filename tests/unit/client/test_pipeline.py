"""From messages to pictures: a small clip, encoded here, decoded and drawn by the pipeline."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cags_client.actions import Decode
from cags_client.pipeline import ClientPipeline
from cags_client.score import averages, score
from cags_client.settings import ClientSettings
from cags_common import raster
from cags_common.bundle import BundleReader
from cags_common.errors import ConfigError, DecodeError
from cags_common.geometry import Camera, Intrinsics, Pose
from cags_common.metrics import psnr
from cags_common.packing import crc32
from cags_common.poses import Focus, synthetic_walk
from cags_common.raster.base import Footprint, RasterScene, RenderedView, RenderOptions
from cags_common.video.h264 import H264Encoder
from cags_encoder import EncodeSettings, encode
from cags_encoder.scenes import open_scene
from cags_protocol import events as ev
from cags_protocol.messages import FrameEnd, ReferenceFrame, TileLayers
from support.small_motion import looks, motion, moving
from support.small_store import books

SMALL = Intrinsics.of_fov(80, 60, 1.2, 1.0)


@pytest.fixture(scope="module")
def reader(tmp_path_factory: pytest.TempPathFactory) -> BundleReader:
    folder: Path = tmp_path_factory.mktemp("bundle") / "room"
    settings = EncodeSettings(frames=3, quantiser="paper-66", train_splats=4096)
    encode(open_scene("procedural:size=3000,frames=3"), settings, str(folder))
    return BundleReader.open(str(folder))


def pipeline(reader: BundleReader, **settings: object) -> ClientPipeline:
    made = ClientSettings(**{"width": 160, "height": 120, **settings})  # type: ignore[arg-type]
    return ClientPipeline(reader.manifest, reader.codebooks(), made)


def send(pipe: ClientPipeline, reader: BundleReader, frame: int, lods: int = 1) -> None:
    for entry in reader.frame(frame).tiles:
        levels = min(lods, len(entry.lod_bytes))
        parts = [reader.payload(frame, entry.tile, lod) for lod in range(levels)]
        message = TileLayers(frame, entry.tile, 0, levels, tuple(map(len, parts)), entry.crcs[:levels])
        assert pipe.on_tiles([(message, memoryview(b"".join(parts)))]) == []
    pipe.on_frame_end(FrameEnd(frame), memoryview(reader.removed_payload(frame)))


def pose_of(reader: BundleReader, t_us: int = 1_400_000) -> Pose:
    m = reader.manifest
    return synthetic_walk("walking", Focus(m.focus_centre, m.focus_radius, m.up), duration_s=2).pose_at(t_us)


def truth(reader: BundleReader, frame: int, camera: Camera, footprint: Footprint | None = None) -> np.ndarray:
    scene = raster.create("auto").load(reader.source(frame).splats)
    return np.clip(scene.render(camera, RenderOptions(footprint=footprint or Footprint())).rgb, 0, 1)


def reference(
    pipe: ClientPipeline, reader: BundleReader, frame: int, pose: Pose, seq: int = 1
) -> tuple[ReferenceFrame, memoryview]:
    view = Intrinsics.of_fov(80, 60, 1.3, 1.1)
    camera = Camera(view, pose, reader.manifest.near)
    rgb = truth(reader, frame, camera, Footprint.of(pipe.settings.intrinsics, view))
    return ReferenceFrame(frame, seq, pose, view, idr=True), memoryview(H264Encoder(80, 60, 30).encode(rgb, idr=True))


def test_a_frame_is_restored_towards_the_truth(reader: BundleReader) -> None:
    pipe, pose = pipeline(reader), pose_of(reader)
    send(pipe, reader, 0)
    assert pipe.on_reference(*reference(pipe, reader, 0, pose))
    shown = pipe.present(0, pipe.camera(pose))
    true = truth(reader, 0, shown.camera)
    scores = score(shown, true, np.ones((120, 160), np.float32))
    assert scores["psnr_restored_db"] > scores["psnr_distorted_db"] + 1
    assert scores["psnr_restored_db"] == pytest.approx(psnr(shown.rgb, true))
    assert not shown.missed
    assert shown.lod_mean == 0
    assert averages([scores, scores])["psnr_restored_db"] == pytest.approx(scores["psnr_restored_db"])


def test_without_a_reference_the_distorted_picture_is_shown(reader: BundleReader) -> None:
    pipe, pose = pipeline(reader), pose_of(reader)
    send(pipe, reader, 0)
    shown = pipe.present(0, pipe.camera(pose))
    assert shown.aligned is None
    np.testing.assert_array_equal(shown.rgb, shown.distorted)


def test_at_the_top_of_the_ladder_nothing_is_restored(reader: BundleReader) -> None:
    pipe, pose = pipeline(reader), pose_of(reader)
    send(pipe, reader, 0, lods=reader.manifest.lods)
    pipe.on_reference(*reference(pipe, reader, 0, pose))
    shown = pipe.present(0, pipe.camera(pose))
    np.testing.assert_array_equal(shown.rgb, shown.distorted)
    assert shown.lod_mean == reader.manifest.lods - 1


def test_a_restorer_that_replaces_the_picture_does_so_at_the_top_too(reader: BundleReader) -> None:
    pipe, pose = pipeline(reader, restore="reference"), pose_of(reader)
    send(pipe, reader, 0, lods=reader.manifest.lods)
    pipe.on_reference(*reference(pipe, reader, 0, pose))
    shown = pipe.present(0, pipe.camera(pose))
    assert shown.aligned is not None
    assert not np.array_equal(shown.rgb, shown.distorted)


def test_an_old_reference_fades_and_a_very_old_one_is_not_used(reader: BundleReader) -> None:
    pipe, pose = pipeline(reader, reference_age=2), pose_of(reader)
    strict = pipeline(reader, reference_age=1)
    for each in (pipe, strict):
        for frame in range(3):
            send(each, reader, frame)
        each.on_reference(*reference(each, reader, 0, pose))
    fresh, beside, older = (pipe.present(frame, pipe.camera(pose)) for frame in range(3))
    assert fresh.aligned is not None
    assert beside.aligned is not None
    assert older.aligned is not None
    assert beside.aligned.confidence.max() == fresh.aligned.confidence.max()
    assert older.aligned.confidence.max() == pytest.approx(fresh.aligned.confidence.max() * 2 / 3)
    assert strict.present(2, strict.camera(pose)).aligned is None


def test_a_reference_of_a_frame_to_come_is_not_used(reader: BundleReader) -> None:
    pipe, pose = pipeline(reader), pose_of(reader)
    send(pipe, reader, 0)
    pipe.on_reference(*reference(pipe, reader, 1, pose))
    assert pipe.present(0, pipe.camera(pose)).reference is None
    send(pipe, reader, 1)
    shown = pipe.present(1, pipe.camera(pose))
    assert shown.reference is not None
    assert not np.array_equal(shown.rgb, shown.distorted)


class CountingScene:
    """Counts how often a scene is drawn from a reference's camera."""

    def __init__(self, scene: RasterScene) -> None:
        self.scene, self.drawn = scene, 0

    def render(self, camera: Camera, options: RenderOptions) -> RenderedView:
        self.drawn += camera.width_px == 80
        return self.scene.render(camera, options)

    def __getattr__(self, name: str) -> object:
        return getattr(self.scene, name)


def test_own_views_of_a_reference_are_drawn_only_where_the_splats_have_changed(reader: BundleReader) -> None:
    pipe, pose = pipeline(reader), pose_of(reader)
    for frame in range(3):
        send(pipe, reader, frame)
    pipe.on_reference(*reference(pipe, reader, 0, pose))
    counts = []
    for frame in (0, 0, 1, 2, 2):
        if frame == 2 and len(counts) == 3:
            pipe.on_reference(*reference(pipe, reader, 2, pose))
        shown = pipe.present(frame, pipe.camera(pose))
        assert not np.array_equal(shown.rgb, shown.distorted)
        if not isinstance(pipe._scene, CountingScene):
            assert pipe._scene is not None
            counter = CountingScene(pipe._scene)
            pipe._scene = counter  # type: ignore[assignment]
        counts.append(counter.drawn)
    assert counts == [0, 0, 1, 2, 2], "nothing changed; as of now; of the new reference; nothing changed"


def test_a_frame_that_did_not_come_shows_the_looks_of_the_one_before_and_their_motion_goes_on(
    reader: BundleReader,
) -> None:
    pipe, pose = pipeline(reader), pose_of(reader)
    send(pipe, reader, 0)
    pipe.present(0, pipe.camera(pose))
    assert pipe.on_display is not None
    splats = pipe.on_display.splats
    before = splats.take(slice(None))
    before = replace(before, **{name: column.copy() for name, column in before.arrays()})
    assert pipe.present(1, pipe.camera(pose)).missed
    for name in ("log_scales", "sh0", "sh_rest"):
        np.testing.assert_array_equal(getattr(splats, name), getattr(before, name))
    assert (splats.means != before.means).any()
    send(pipe, reader, 1)
    assert not pipe.present(1, pipe.camera(pose)).missed


def test_a_half_received_frame_is_no_worse_for_being_restored(reader: BundleReader) -> None:
    """Every other tile of the first frame has not come: the reference shows what the client has no splats for."""
    pipe, pose = pipeline(reader), pose_of(reader)
    for entry in reader.frame(0).tiles[::2]:
        payload = reader.payload(0, entry.tile, 0)
        message = TileLayers(0, entry.tile, 0, 1, (len(payload),), entry.crcs[:1])
        assert pipe.on_tiles([(message, memoryview(payload))]) == []
    pipe.on_frame_end(FrameEnd(0), memoryview(reader.removed_payload(0)))
    pipe.on_reference(*reference(pipe, reader, 0, pose))
    shown, true = pipe.present(0, pipe.camera(pose)), truth(reader, 0, pipe.camera(pose))
    assert psnr(shown.rgb, true) >= psnr(shown.distorted, true) - 0.1
    assert np.isfinite(shown.rgb).all()
    assert 0 <= shown.rgb.min() <= shown.rgb.max() <= 1


def test_adaptation_improves_the_clients_own_picture_frame_by_frame(reader: BundleReader) -> None:
    pipe, pose = pipeline(reader, adapt="sirt"), pose_of(reader)
    send(pipe, reader, 0)
    pipe.on_reference(*reference(pipe, reader, 0, pose))
    true = truth(reader, 0, pipe.camera(pose))
    quality = [psnr(pipe.present(0, pipe.camera(pose)).distorted, true) for _ in range(4)]
    assert quality[1] > quality[0] + 0.5
    assert quality[3] > quality[1]


def test_adaptation_in_the_background_gives_the_same_pictures(reader: BundleReader) -> None:
    """A step is taken over when it is done; before splats change it is waited for."""
    pose, shown = pose_of(reader), []
    with ThreadPoolExecutor(1) as executor:
        for background in (None, executor):
            pipe = ClientPipeline(
                reader.manifest,
                reader.codebooks(),
                ClientSettings(width=160, height=120, adapt="sirt"),
                background=background,
            )
            for frame in range(3):
                send(pipe, reader, frame)
                pipe.on_reference(*reference(pipe, reader, frame, pose, frame + 1))
                shown.append(pipe.present(frame, pipe.camera(pose)).rgb)
                executor.submit(int).result()  # the step has ended
    for inline, behind in zip(shown[:3], shown[3:], strict=True):
        np.testing.assert_array_equal(inline, behind)


def test_a_damaged_reference_asks_for_an_idr_and_is_not_shown(reader: BundleReader) -> None:
    pipe, pose = pipeline(reader), pose_of(reader)
    send(pipe, reader, 0)
    message, unit = reference(pipe, reader, 0, pose)
    with pytest.raises(DecodeError):
        pipe.on_reference(message, memoryview(b"\x00" * 40))
    late = ReferenceFrame(1, 3, pose, message.intrinsics, idr=False)
    assert not pipe.on_reference(late, unit[:0] or memoryview(bytes(unit)[:0] or b"\x00\x00\x01\x41\x9a"))
    assert pipe.present(0, pipe.camera(pose)).reference is None
    assert pipe.last_reference_seq == 0


def test_unknown_restorers_are_named(reader: BundleReader) -> None:
    with pytest.raises(ConfigError, match="magic"):
        pipeline(reader, restore="magic")


def test_the_end_of_a_frame_that_the_clip_does_not_have_is_reported_like_any_damage(reader: BundleReader) -> None:
    pipe = pipeline(reader, restore="none")
    ends = [ev.FrameEnded(FrameEnd(frame), memoryview(b"")) for frame in (2**31 - 1, 0)]
    result = Decode(tuple(ends), pipe).run()
    assert [str(error) for error in result.errors] == ["frame 2147483647 is outside the clip's 3 frames"]
    assert result.whole == 0


@pytest.mark.parametrize("size", [(160, 120), (161, 119)])
def test_at_half_resolution_a_frame_is_restored_and_everything_looked_at_is_whole(
    reader: BundleReader, size: tuple[int, int]
) -> None:
    width, height = size
    scores = {}
    for resolution in ("full", "half"):
        pipe, pose = pipeline(reader, width=width, height=height, resolution=resolution), pose_of(reader)
        send(pipe, reader, 0)
        pipe.on_reference(*reference(pipe, reader, 0, pose))
        shown = pipe.present(0, pipe.camera(pose))
        true = truth(reader, 0, shown.camera)
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
    pipe = ClientPipeline(of, books().to_bytes(), made)
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


def test_a_reference_of_an_earlier_frame_is_compared_with_what_is_where_it_is_now() -> None:
    pipe = moving_pipeline(restore="affine", effects="always", reference_age=10)
    camera = pipe.camera(MOVING_VIEW)
    view = Camera(Intrinsics.of_fov(80, 60, 1.2, 1.0), MOVING_VIEW, pipe.info.near)
    pipe.present(0, camera)
    store = pipe.on_display
    assert store is not None
    scene = raster.create("cpu").load(store.splats)
    options = RenderOptions(footprint=Footprint.of(pipe.settings.intrinsics, view.intrinsics))
    then = scene.render(view, options).rgb
    picture = H264Encoder(80, 60, 30).encode(np.clip(then, 0, 1), idr=True)
    assert pipe.on_reference(ReferenceFrame(0, 1, MOVING_VIEW, view.intrinsics, idr=True), memoryview(picture))
    for frame, share in ((1, 0.0), (2, 0.0), (2, 0.5), (3, 0.0)):
        shown = pipe.present(frame, camera, share)
        assert shown.reference is not None
        fresh = raster.create("cpu").load(pipe.on_display.splats).render(view, options)  # type: ignore[union-attr]
        assert pipe._views._now is not None
        np.testing.assert_array_equal(pipe._views._now.picture.rgb, fresh.rgb)
