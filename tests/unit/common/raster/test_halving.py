"""Pictures at half the pixels a side, brought up: what they keep."""

from __future__ import annotations

import numpy as np
import pytest

import cags_kernels
from cags_common.geometry import Camera, Intrinsics, Pose
from cags_common.raster.halving import enlarged, halved


def display(width: int, height: int) -> Camera:
    return Camera(Intrinsics.of_fov(width, height, 1.0, 0.8), Pose.identity(), 0.1)


@pytest.mark.parametrize(("width", "height"), [(64, 48), (65, 49), (1, 1)])
def test_the_view_stays_and_odd_last_pixels_are_halved(width: int, height: int) -> None:
    whole = display(width, height)
    half = halved(whole)
    assert (half.width_px, half.height_px) == ((width + 1) // 2, (height + 1) // 2)
    for corner in ((0.0, 0.0), (width, height)):  # a ray through the corner is the same ray
        assert (corner[0] - whole.intrinsics.cx_px) / whole.intrinsics.fx_px == pytest.approx(
            (corner[0] / 2 - half.intrinsics.cx_px) / half.intrinsics.fx_px
        )


@pytest.mark.parametrize("native", [True, False])
@pytest.mark.parametrize("size", [(64, 48), (63, 47), (1, 1), (2, 1), (1, 7)])
def test_pictures_come_up_to_any_size_in_range(size, native, monkeypatch):
    monkeypatch.setattr(cags_kernels, "native_available", lambda: native and cags_kernels.library.native_available())
    camera = display(*size)
    small = halved(camera)
    rng = np.random.default_rng(0)
    picture = np.float32(rng.random((small.height_px, small.width_px, 3)) > 0.5)  # nothing but edges
    whole = enlarged(picture, camera, 2)
    assert whole.shape == (camera.height_px, camera.width_px, 3)
    assert whole.min() >= 0
    assert whole.max() <= 1
    flat = np.full_like(picture, 0.625)
    np.testing.assert_allclose(enlarged(flat, camera, 1), 0.625, atol=1e-6)


@pytest.mark.skipif(not cags_kernels.native_available(), reason=cags_kernels.why_unavailable())
@pytest.mark.parametrize("size", [(64, 48), (61, 35)])
def test_the_kernel_brings_up_as_opencv_does(size, monkeypatch):
    camera = display(*size)
    small = halved(camera)
    picture = np.random.default_rng(1).random((small.height_px, small.width_px, 3), dtype=np.float32)
    fast = enlarged(picture, camera, 3)
    monkeypatch.setattr(cags_kernels, "native_available", lambda: False)
    np.testing.assert_allclose(fast, enlarged(picture, camera, 1), atol=1e-5)


@pytest.mark.parametrize("native", [True, False])
def test_a_picture_of_another_size_is_refused(native, monkeypatch):
    monkeypatch.setattr(cags_kernels, "native_available", lambda: native and cags_kernels.library.native_available())
    with pytest.raises(ValueError, match="is not half of 9x9 px"):
        enlarged(np.zeros((4, 5, 3), np.float32), display(9, 9), 1)


def test_a_ramp_lies_where_it_lay():
    """Half-pixel centres: column j of the half picture lies between columns 2 j and 2 j + 1, to a tenth of a pixel."""
    camera = display(32, 8)
    ramp = np.broadcast_to((np.arange(16, dtype=np.float32)[None, :, None] * 2 + 1) / 32, (4, 16, 3))
    whole = enlarged(np.ascontiguousarray(ramp), camera, 1)
    np.testing.assert_allclose(whole[4, 4:-4, 0], (np.arange(32)[4:-4] + 0.5) / 32, atol=0.1 / 32)
