"""What alignment must do, on scenes whose answer is known. Every aligner passes the same tests."""

import math

import cv2
import numpy as np
import pytest

from cags_client.frame.align import ALIGNERS, Aligned, Aligner, AlignSettings, ReferencePicture, create
from cags_common.errors import ConfigError
from cags_common.geometry import Camera, Intrinsics, Pose

TOLERANCE = 2e-5
TRUE_ALIGNERS = sorted(set(ALIGNERS.names()) - {"unaligned", "rotation"})
LARGE = Intrinsics.of_fov(160, 120, 1.0, 0.8)
SMALL = Intrinsics.of_fov(40, 30, 1.0, 0.8)


@pytest.fixture(params=TRUE_ALIGNERS)
def aligner(request: pytest.FixtureRequest) -> Aligner:
    return create(request.param)


def texture(height: int, width: int, seed: int = 0) -> np.ndarray:
    noise = np.random.default_rng(seed).random((height, width, 3)).astype(np.float32)
    return cv2.GaussianBlur(noise, (0, 0), 1.5)


def picture(view: Intrinsics = SMALL, pose: Pose | None = None, rgb: np.ndarray | None = None) -> ReferencePicture:
    rgb = texture(view.height_px, view.width_px) if rgb is None else rgb
    return ReferencePicture(rgb, Camera(view, pose or Pose.identity()), frame=0)


def flat(view: Intrinsics, depth: float) -> np.ndarray:
    return np.full((view.height_px, view.width_px), depth, np.float32)


def turned(angle: float, position: tuple[float, float, float] = (0, 0, 0)) -> Pose:
    return Pose(position, (math.cos(angle / 2), 0.0, math.sin(angle / 2), 0.0))


def seen_from_afar(point: np.ndarray) -> np.ndarray:
    """A colour for every direction of the world: smooth, so that sampling error is small."""
    unit = point / np.linalg.norm(point, axis=-1, keepdims=True)
    return (0.5 + 0.4 * np.sin(3 * unit)).astype(np.float32)


def rays(view: Intrinsics, pose: Pose) -> np.ndarray:
    v, u = np.mgrid[0 : view.height_px, 0 : view.width_px] + 0.5
    local = np.stack([(u - view.cx_px) / view.fx_px, (v - view.cy_px) / view.fy_px, np.ones_like(u)], axis=-1)
    return local @ pose.rotation_matrix.T


def test_an_identity_returns_the_reference(aligner: Aligner) -> None:
    reference = picture(LARGE)
    depth = 1 + 3 * texture(120, 160, seed=1)[..., 0]
    out = aligner.align(reference, depth, Camera(LARGE, Pose.identity()))
    np.testing.assert_allclose(out.rgb, reference.rgb, atol=TOLERANCE)
    assert not out.occluded.any()
    assert out.confidence[10:-10, 10:-10].min() == 1.0


def test_an_identity_of_a_small_reference_is_plain_bilinear_upsampling(aligner: Aligner) -> None:
    reference = picture(SMALL)
    depth = 1 + 30 * texture(120, 160, seed=1)[..., 0]  # however rough the surface is
    out = aligner.align(reference, depth, Camera(LARGE, Pose.identity()))
    upsampled = cv2.resize(reference.rgb, (160, 120), interpolation=cv2.INTER_LINEAR)
    np.testing.assert_allclose(out.rgb, upsampled, atol=TOLERANCE)


def test_a_smooth_slanted_surface_has_no_occlusion_under_an_identity(aligner: Aligner) -> None:
    depth = np.tile(np.linspace(1, 40, 160, dtype=np.float32) ** 2, (120, 1))
    assert not aligner.align(picture(SMALL), depth, Camera(LARGE, Pose.identity())).occluded.any()


@pytest.mark.parametrize("axis", [0, 1], ids=["wall", "floor"])
def test_a_plane_at_a_grazing_angle_hides_nothing(aligner: Aligner, axis: int) -> None:
    """Pixels from several cells' distance share one of the reference's, at depths far apart: a slope, not a step."""
    along = rays(LARGE, Pose.identity())[..., axis]
    depth = np.where(along > 0.02, 1 / np.maximum(along, 0.02), 50).astype(np.float32)  # a metre aside, then a far wall
    nearer = (0.3, 0.0, 0.0) if axis == 0 else (0.0, 0.3, 0.0)
    reference = picture(SMALL, Pose(nearer, (1.0, 0.0, 0.0, 0.0)))
    out = aligner.align(reference, depth, Camera(LARGE, Pose.identity()))
    plane = (along > 0.05) & (along < 0.3)
    assert depth[plane].max() > 15
    assert not out.occluded[plane].any()


def test_a_pure_rotation_does_not_depend_on_depth(aligner: Aligner) -> None:
    pose = turned(0.2)
    reference = picture(LARGE, pose, seen_from_afar(rays(LARGE, pose)))
    here = Camera(LARGE, Pose.identity())
    near, far = (aligner.align(reference, flat(LARGE, d), here) for d in (0.5, 500.0))
    np.testing.assert_allclose(near.rgb, far.rgb, atol=1e-4)
    shown = near.confidence > 0.99
    assert 0.5 < shown.mean() < 0.95
    expected = seen_from_afar(rays(LARGE, Pose.identity()))
    np.testing.assert_allclose(near.rgb[shown], expected[shown], atol=2e-3)


def test_a_plane_seen_through_two_different_cameras(aligner: Aligner) -> None:
    """Errata: the projection into the reference takes the reference's intrinsics and the client's pose."""
    wide = Intrinsics(70, 50, 45.0, 52.0, 33.0, 27.0)
    poses = turned(-0.15, (0.3, -0.1, 0.2)), turned(0.1, (-0.2, 0.15, 0.1))

    def on_plane(view: Intrinsics, pose: Pose) -> tuple[np.ndarray, np.ndarray]:
        direction = rays(view, pose)
        distance = (3.0 - pose.position[2]) / direction[..., 2]  # the plane z = 3
        return np.asarray(pose.position) + direction * distance[..., None], distance

    def paint(points: np.ndarray) -> np.ndarray:
        return (0.5 + 0.4 * np.sin(points[..., [0, 1, 0]] * np.array([1.5, 2.0, 0.7]))).astype(np.float32)

    reference = picture(wide, poses[1], paint(on_plane(wide, poses[1])[0]))
    points, depth = on_plane(LARGE, poses[0])
    out = aligner.align(reference, depth.astype(np.float32), Camera(LARGE, poses[0]))
    shown = out.confidence > 0.99
    assert shown.mean() > 0.5
    assert not out.occluded.any()
    np.testing.assert_allclose(out.rgb[shown], paint(points)[shown], atol=4e-3)


def step_scene() -> tuple[ReferencePicture, np.ndarray, np.ndarray]:
    """A red square 1 m away before a green wall 3 m away; the reference stands 30 cm to the left."""
    depth = flat(LARGE, 3.0)
    square = np.zeros(depth.shape, bool)
    square[40:80, 60:100] = True
    depth[square] = 1.0
    rgb = np.zeros((30, 40, 3), np.float32)
    rgb[..., 1] = 1.0
    shift = 0.3 * SMALL.fx_px  # reference pixels that the square moves by
    columns = (np.arange(40) + 0.5 >= 15 + shift) & (np.arange(40) + 0.5 <= 25 + shift)
    rgb[10:20, columns] = (1, 0, 0)
    return picture(SMALL, Pose((-0.3, 0, 0), (1, 0, 0, 0)), rgb), depth, square


def test_what_the_reference_cannot_see_is_occluded_and_filled_from_behind(aligner: Aligner) -> None:
    reference, depth, square = step_scene()
    out = aligner.align(reference, depth, Camera(LARGE, Pose.identity()))
    assert out.occluded.sum() > 500
    assert not out.occluded[square].any()
    assert (out.confidence[out.occluded] == 0).all()
    hidden = out.rgb[out.occluded]
    green = (hidden[:, 1] > 0.6).mean()
    bare = create("oracle", AlignSettings(erosion_iterations=0)).align(reference, depth, Camera(LARGE, Pose.identity()))
    assert green > 0.6 > (bare.rgb[out.occluded][:, 1] > 0.6).mean()


def test_a_thin_pole_after_a_step_of_30_cm(aligner: Aligner) -> None:
    """A red pole of three client pixels, less than one of the reference's, 1 m away; a green wall 2 m away."""
    depth = flat(LARGE, 2.0)
    depth[:, 79:82] = 1.0
    rgb = np.zeros((30, 40, 3), np.float32)
    rgb[..., 1] = 0.8
    in_reference = 20 + (0.5 / LARGE.fx_px + 0.3) * SMALL.fx_px
    rgb[:, int(in_reference)] = (0.8, 0, 0)
    reference = picture(SMALL, Pose((-0.3, 0, 0), (1, 0, 0, 0)), rgb)
    out = aligner.align(reference, depth, Camera(LARGE, Pose.identity()))
    behind = 80 + 0.15 * LARGE.fx_px + 0.25  # where the wall lies behind the pole for the reference
    columns = np.nonzero(out.occluded.any(axis=0))[0]
    assert 0 < len(columns) <= 2 * LARGE.fx_px / SMALL.fx_px + 1
    assert np.abs(columns + 0.5 - behind).max() <= 2 * LARGE.fx_px / SMALL.fx_px
    assert (out.confidence[15:105, 79:82] == 1).all()
    assert (out.rgb[15:105, 80, 0] > out.rgb[15:105, 80, 1]).all()
    assert out.rgb.min() >= 0
    assert out.rgb.max() <= 1
    assert np.isfinite(out.rgb).all()


def test_erosion_does_not_depend_on_the_order_of_pixels(aligner: Aligner) -> None:
    """The mirrored scene gives the mirrored result, which last-writer-wins would not."""
    reference, depth, _ = step_scene()
    mirrored = ReferencePicture(
        np.ascontiguousarray(reference.rgb[:, ::-1]), Camera(SMALL, Pose((0.3, 0, 0), (1, 0, 0, 0))), 0
    )
    here = Camera(LARGE, Pose.identity())
    out = aligner.align(reference, depth, here)
    back = aligner.align(mirrored, np.ascontiguousarray(depth[:, ::-1]), here)
    np.testing.assert_array_equal(out.occluded, back.occluded[:, ::-1])
    np.testing.assert_allclose(out.rgb, back.rgb[:, ::-1], atol=1e-4)


def test_the_threshold_follows_the_scale_of_the_scene(aligner: Aligner) -> None:
    reference, depth, _ = step_scene()
    position = tuple(100 * c for c in reference.camera.pose.position)
    large = ReferencePicture(reference.rgb, reference.camera.at(Pose(position, (1, 0, 0, 0))), 0)
    one = aligner.align(reference, depth, Camera(LARGE, Pose.identity()))
    hundred = aligner.align(large, depth * 100, Camera(LARGE, Pose.identity()))
    np.testing.assert_array_equal(one.occluded, hundred.occluded)


def test_all_aligners_agree() -> None:
    reference, depth, _ = step_scene()
    rough = (depth * (1 + 0.02 * texture(120, 160)[..., 0])).astype(np.float32)
    camera = Camera(LARGE, turned(0.05, (0.02, 0.03, -0.1)))
    outs = [create(name).align(reference, rough, camera) for name in TRUE_ALIGNERS]
    for out in outs[1:]:
        np.testing.assert_allclose(out.rgb, outs[0].rgb, atol=1e-4)
        np.testing.assert_allclose(out.confidence, outs[0].confidence, atol=1e-4)
        assert (out.occluded != outs[0].occluded).mean() < 1e-4


def check_sane(out: Aligned, camera: Camera) -> None:
    assert out.rgb.shape == (camera.height_px, camera.width_px, 3)
    for array in (out.rgb, out.confidence):
        assert np.isfinite(array).all()
        assert array.min() >= 0.0
        assert array.max() <= 1.0
    for array in out.geometry.projected[:3]:
        assert np.isfinite(array).all()


@pytest.mark.parametrize("bad", [0.0, -1.0, math.inf, -math.inf, math.nan, 1e30, 1e-30])
def test_depth_that_means_nothing_gives_no_confidence(aligner: Aligner, bad: float) -> None:
    depth = flat(LARGE, 2.0)
    depth[::3, ::2] = bad
    camera = Camera(LARGE, turned(0.1, (0.1, 0, 0.05)))
    out = aligner.align(picture(), depth, camera)
    check_sane(out, camera)
    if not 0 < bad < math.inf:
        assert (out.confidence[::3, ::2] == 0).all()


def test_points_behind_the_reference_say_nothing(aligner: Aligner) -> None:
    camera = Camera(LARGE, Pose.identity())
    out = aligner.align(picture(pose=turned(math.pi)), flat(LARGE, 2.0), camera)
    check_sane(out, camera)
    assert (out.confidence == 0).all()
    assert (out.rgb == 0).all()


def test_no_colours_from_beyond_the_border(aligner: Aligner) -> None:
    camera = Camera(LARGE, turned(0.6))
    out = aligner.align(picture(rgb=np.ones((30, 40, 3), np.float32)), flat(LARGE, 2.0), camera)
    check_sane(out, camera)
    assert (out.rgb[out.confidence == 0] == 0).mean() > 0.9
    assert 0 < (out.confidence > 0).mean() < 0.9


@pytest.mark.parametrize("client", [(1, 1), (3, 1), (1, 5), (7, 5)])
@pytest.mark.parametrize("other", [(1, 1), (2, 3), (5, 1)])
def test_tiny_and_odd_sizes(aligner: Aligner, client: tuple[int, int], other: tuple[int, int]) -> None:
    camera = Camera(Intrinsics.of_fov(*client, 1.0, 1.0), Pose.identity())
    out = aligner.align(picture(Intrinsics.of_fov(*other, 1.0, 1.0)), flat(camera.intrinsics, 1.5), camera)
    check_sane(out, camera)


def test_a_black_reference_and_a_void_view(aligner: Aligner) -> None:
    camera = Camera(LARGE, Pose.identity())
    black = aligner.align(picture(rgb=np.zeros((30, 40, 3), np.float32)), flat(LARGE, 2.0), camera)
    assert (black.rgb == 0).all()
    void = aligner.align(picture(), flat(LARGE, math.inf), camera)
    assert (void.confidence == 0).all()
    assert (void.rgb == 0).all()


def test_a_depth_of_another_size_is_refused(aligner: Aligner) -> None:
    with pytest.raises(ValueError, match="depth of shape"):
        aligner.align(picture(), flat(SMALL, 1.0), Camera(LARGE, Pose.identity()))


def test_a_reference_that_is_not_its_cameras_size_is_refused() -> None:
    with pytest.raises(ValueError, match="reference of shape"):
        picture(SMALL, rgb=np.zeros((30, 41, 3), np.float32))


def test_unaligned_ignores_the_pose_but_not_the_field_of_view() -> None:
    wide = Intrinsics.of_fov(40, 30, 1.4, 1.2)
    camera = Camera(LARGE, Pose.identity())
    here, there = (
        create("unaligned").align(picture(wide, p), flat(LARGE, 2.0), camera) for p in (Pose.identity(), turned(1))
    )
    np.testing.assert_array_equal(here.rgb, there.rgb)
    straight = create("oracle").align(picture(wide), flat(LARGE, 2.0), camera)
    np.testing.assert_allclose(here.rgb, straight.rgb, atol=1e-4)


def test_colours_are_made_at_once_where_they_are_asked_for_and_are_the_same_later() -> None:
    reference, depth, _ = step_scene()
    at_once, later = (
        create("fast").align(reference, depth, Camera(LARGE, Pose.identity()), colours=colours)
        for colours in (True, False)
    )
    assert ("rgb" in vars(at_once), "rgb" in vars(later)) == (True, False)
    np.testing.assert_array_equal(at_once.rgb, later.rgb)


def test_an_unknown_aligner_is_named() -> None:
    with pytest.raises(ConfigError, match="'magic' is unknown; known: fast, oracle"):
        create("magic")


def test_rotation_alone_turns_the_reference_without_any_depth() -> None:
    pose = turned(0.1, (0.3, 0.0, 0.0))
    reference = picture(LARGE, pose, seen_from_afar(rays(LARGE, pose)))
    void = np.full((120, 160), np.inf, np.float32)
    here = Camera(LARGE, Pose.identity())
    out = create("rotation").align(reference, void, here)
    shown = out.confidence >= 1
    assert shown.mean() > 0.8
    np.testing.assert_allclose(out.rgb[shown], seen_from_afar(rays(LARGE, here.pose))[shown], atol=2e-3)
    assert not out.occluded.any()


@pytest.mark.parametrize("angle", [0.0, 0.05, 0.2])
def test_from_one_place_nothing_is_hidden(aligner: Aligner, angle: float) -> None:
    """So that the test for it may be left out."""
    reference = picture(LARGE, turned(angle))
    depth = 1 + 3 * texture(120, 160, seed=1)[..., 0]
    tested, untested = (
        aligner.align(reference, depth, Camera(LARGE, Pose.identity()), occlusion=on) for on in (True, False)
    )
    assert not tested.occluded.any()
    np.testing.assert_array_equal(tested.rgb, untested.rgb)
    np.testing.assert_array_equal(tested.confidence, untested.confidence)
