"""Half the pixels a side, and back."""

from __future__ import annotations

import numpy as np
import pytest

import cags_kernels
from cags_common.raster.halving import enlarged, halved
from support.raster_scenes import camera


@pytest.mark.parametrize(("width", "height"), [(64, 48), (65, 49), (1, 1)])
def test_the_view_stays_and_odd_last_pixels_are_halved(width: int, height: int) -> None:
    whole = camera(width, height)
    half = halved(whole)
    assert (half.width_px, half.height_px) == ((width + 1) // 2, (height + 1) // 2)
    for corner in ((0.0, 0.0), (width, height)):  # a ray through the corner is the same ray
        assert (corner[0] - whole.intrinsics.cx_px) / whole.intrinsics.fx_px == pytest.approx(
            (corner[0] / 2 - half.intrinsics.cx_px) / half.intrinsics.fx_px
        )


@pytest.mark.parametrize("native", [True, False])
def test_a_flat_picture_stays_flat_and_a_picture_of_another_size_is_refused(
    native: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    if native and not cags_kernels.native_available():
        pytest.skip(str(cags_kernels.why_unavailable()))
    monkeypatch.setattr(cags_kernels, "native_available", lambda: native)
    whole = camera(33, 18)
    flat = np.full((9, 17, 3), 0.25, np.float32)
    assert np.allclose(enlarged(flat, whole, 1), 0.25, atol=1e-6)
    assert enlarged(flat, whole, 1).shape == (18, 33, 3)
    with pytest.raises(ValueError, match="33"):
        enlarged(flat[:, :-1], whole, 1)


def test_both_ways_give_the_same_picture(monkeypatch: pytest.MonkeyPatch) -> None:
    if not cags_kernels.native_available():
        pytest.skip(str(cags_kernels.why_unavailable()))
    picture = np.random.default_rng(3).random((12, 20, 3), np.float32)
    native = enlarged(picture, camera(40, 24), 2)
    monkeypatch.setattr(cags_kernels, "native_available", lambda: False)
    assert np.abs(native - enlarged(picture, camera(40, 24), 1)).max() < 1e-4
