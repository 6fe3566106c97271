"""What of a difference is sent: that which does not go when the viewer turns."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from cags_common.correction.reach import HOLDS
from cags_common.geometry import F32, Camera, Intrinsics, Pose
from cags_common.poses import Focus
from cags_server.reference.lasting import COMPARABLE, FORESEEN, NEWS, REACH, SMALL, WHOLE, Lasting, blocks_of
from support.splat_files import random_splats

INTRINSICS = Intrinsics.of_fov(160, 120, 1.0, 0.8)
DEPTH = np.full((120, 160), 2.0, np.float32)


def camera(x_m: float = 0.0, yaw_rad: float = 0.0) -> Camera:
    return Camera(INTRINSICS, Pose((x_m, 0.0, 0.0), (float(np.cos(yaw_rad / 2)), 0.0, float(np.sin(yaw_rad / 2)), 0.0)))


def texture(seed: int = 0, columns: int = 160) -> F32:
    """Of a mean square of 1e-5: 50 dB."""
    noise = np.random.default_rng(seed).normal(size=(120, columns, 3)).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 2.0)
    return np.asarray(smooth * np.float32(np.sqrt(1e-5 / np.mean(smooth**2))))


def shared(before: F32, now: F32, seen: Camera | None = None, depth: F32 = DEPTH) -> F32 | None:
    lasting = Lasting()
    assert lasting.share(before, camera(), depth) is None
    return lasting.share(now, seen or camera(), depth)


def test_what_was_lacking_before_is_sent_whole() -> None:
    share = shared(texture(), texture())
    assert share is not None
    assert share.shape == (120, 160)
    assert share.min() > 0.99


def test_a_blob_that_was_not_lacking_before_is_left_out() -> None:
    blob = np.zeros((120, 160, 3), np.float32)
    cv2.circle(blob, (100, 40), 6, (0.04, 0.04, 0.04), -1)
    share = shared(texture(), texture() + blob)
    assert share is not None
    assert share[40, 100] < 0.15
    assert np.median(share) > 0.95


def with_blob() -> F32:
    """The texture, and a splat of 28 dB in its place."""
    blob = np.zeros((120, 160, 3), np.float32)
    cv2.circle(blob, (100, 40), 6, (0.04, 0.04, 0.04), -1)
    return np.asarray(texture() + blob)


def test_where_splats_appear_this_difference_and_the_next_are_sent_whole() -> None:
    lasting, appeared = Lasting(), np.zeros((15, 20), bool)
    appeared[4:6, 11:14] = True
    assert lasting.share(texture(), camera(), DEPTH) is None
    now = lasting.share(with_blob(), camera(), DEPTH, appeared)
    then = lasting.share(texture(3), camera(), DEPTH)
    later = lasting.share(with_blob(), camera(), DEPTH)
    assert now is not None
    assert then is not None
    assert later is not None
    assert min(now[40, 100], then[40, 100]) > 0.99
    assert later[40, 100] < 0.15, "nothing appeared: the order of blending"
    assert np.median(then) < 0.5, "elsewhere it is compared"


def test_blocks_of_splats_are_those_that_they_reach_into() -> None:
    splats = random_splats(40, seed=7)
    splats.log_scales[:] -= 2
    splats.means[:30, 2] = np.abs(splats.means[:30, 2]) + 1
    seen = camera(yaw_rad=0.1)
    blocks = blocks_of(splats, seen)
    assert blocks.shape == (15, 20)
    expected = np.zeros_like(blocks)
    rotation, shift = seen.world_to_camera
    for mean, scales in zip(splats.means, splats.log_scales, strict=True):
        x, y, z = rotation @ mean.astype(np.float64) + shift
        if z <= seen.near:
            continue
        i, radius = seen.intrinsics, REACH * float(np.exp(scales.max())) / z
        for row, column in np.ndindex(blocks.shape):
            beside = abs((column + 0.5) * 8 - (i.fx_px * x / z + i.cx_px)) <= 4 + i.fx_px * radius
            above = abs((row + 0.5) * 8 - (i.fy_px * y / z + i.cy_px)) <= 4 + i.fy_px * radius
            expected[row, column] |= beside and above
    assert expected.any() and not expected.all()
    np.testing.assert_array_equal(blocks, expected)


def test_no_splats_and_splats_behind_the_camera_are_in_no_block() -> None:
    splats = random_splats(5)
    splats.means[:] = (0.0, 0.0, -3.0)
    assert not blocks_of(splats, camera()).any()
    assert not blocks_of(splats.take(slice(0, 0)), camera()).any()


def test_what_is_unlike_what_was_lacking_before_is_hardly_sent() -> None:
    share = shared(texture(1), texture(2))
    assert share is not None
    assert share.mean() < 0.3


@pytest.mark.parametrize("depth_m", [1.0, 4.0])
def test_a_step_aside_is_undone_by_depth(depth_m: float) -> None:
    wall = texture(columns=180)
    step_m = 10 * depth_m / INTRINSICS.fx_px  # ten pixels
    depth = np.full_like(DEPTH, depth_m)
    before, now = (np.ascontiguousarray(wall[:, at : at + 160]) for at in (0, 10))
    stepped, stood = shared(before, now, camera(x_m=step_m), depth), shared(before, now, camera(), depth)
    assert stepped is not None
    assert stood is not None
    assert stepped.mean() > 0.95 > 0.4 > stood.mean()


def test_what_comes_into_view_counts_as_the_rest_of_the_picture_does() -> None:
    wall = texture(columns=220)
    before, now = (np.ascontiguousarray(wall[:, at : at + 160]) for at in (0, 60))
    step = camera(x_m=60 * 2.0 / INTRINSICS.fx_px)
    for kept in (1.0, 0.25):
        share = shared(kept * before, now, step)
        assert share is not None
        assert share[:, 110:].mean() == pytest.approx(min(kept / WHOLE, 1), abs=0.05)


def test_all_of_a_large_difference_is_sent() -> None:
    large, half, small = (np.float32(np.sqrt(power * SMALL / 1e-5)) for power in (3.0, 1.5, 0.9))
    assert shared(large * texture(1), large * texture(2)) is None
    halved, little = shared(half * texture(1), half * texture(2)), shared(small * texture(1), small * texture(2))
    assert halved is not None
    assert little is not None
    assert 1 - halved.mean() == pytest.approx((1 - little.mean()) / 2, rel=0.1)


def test_holes_and_what_lies_behind_the_camera_do_not_count() -> None:
    depth = DEPTH.copy()
    depth[:, :80] = np.inf
    share = shared(texture(), texture(), replace(camera(), pose=Pose((0.0, 0.0, -3.0), (0.0, 0.0, 1.0, 0.0))), depth)
    assert share is not None
    assert np.isfinite(share).all()
    assert share.min() >= 0
    assert share.max() <= 1


def test_it_is_what_lacks_on_the_splats_that_is_large_or_small() -> None:
    depth = np.full_like(DEPTH, np.inf)
    depth[40:70, 60:90] = 2.0  # an object that covers a twentieth of the picture
    on = np.isfinite(depth).astype(np.float32)[..., None]
    large, small = (np.float32(np.sqrt(of * SMALL / 1e-5)) for of in (3.0, 0.5))
    assert shared(on * large * texture(1), on * large * texture(2), depth=depth) is None
    assert shared(on * small * texture(1), on * small * texture(2), depth=depth) is not None


def test_a_large_splat_out_of_order_is_told_from_splats_that_have_come() -> None:
    before = np.float32(np.sqrt(0.5 * SMALL / 1e-5)) * texture(1)
    for growth, whole in ((NEWS * 0.8, False), (NEWS * 1.2, True)):
        now = np.float32(np.sqrt(growth * 0.5 * SMALL / 1e-5)) * texture(2)
        assert (shared(before, now) is None) is whole
        assert (shared(now, before) is None) is whole, "what was lacking before splats came says nothing either"


def test_a_small_difference_reaches_as_far_as_it_has_been_compared_and_a_large_one_farther() -> None:
    def reach(before: F32 | None, now: F32, x_m: float) -> float:
        lasting = Lasting(Focus((0.0, 0.0, 2.0), 1.0))
        if before is not None:
            lasting.share(before, camera(), DEPTH)
        lasting.share(now, camera(x_m), DEPTH)
        return lasting.reach

    small, large = texture(), texture() * np.float32(5)
    assert reach(None, small, 0.0) == 0, "compared with none"
    assert reach(small, small, 0.0) == 0, "from the same place"
    assert reach(small, small, 0.02) == pytest.approx(0.01 * FORESEEN, rel=1e-3)
    assert reach(small, small, 0.2) == HOLDS
    assert reach(small, small, 0.2 + 2 * COMPARABLE) == 0, "what is seen from there tells nothing"
    assert reach(None, large, 0.0) == reach(large, large, 0.02) == HOLDS
