"""The kernels' erosion, on bits of 64 pixels a word, against the readable definition pixel by pixel."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import cags_kernels
from cags_client.align import AlignSettings, ReferencePicture, create
from cags_common.geometry import Camera, Intrinsics, Pose

if not cags_kernels.native_available():
    pytest.skip(cags_kernels.why_unavailable(), allow_module_level=True)

STEP = (-0.2871, 0.0513, 0.0)
"""Of the reference to the side: what is near then hides what is far."""


@st.composite
def scenes(draw: st.DrawFn) -> tuple[ReferencePicture, np.ndarray, Camera]:
    """Near plates and holes before a wall, in pictures around the width of one, two and three words."""
    width, height = draw(st.sampled_from([1, 9, 63, 64, 65, 127, 128, 150])), draw(st.integers(1, 40))
    depth = np.full((height, width), 3.0, np.float32)
    for _ in range(draw(st.integers(0, 6))):
        left, top = draw(st.integers(0, width - 1)), draw(st.integers(0, height - 1))
        across, down = draw(st.integers(1, 70)), draw(st.integers(1, 30))
        depth[top : top + down, left : left + across] = draw(st.sampled_from([1.0, 1.7, np.inf]))
    rng = np.random.default_rng(draw(st.integers(0, 99)))
    there = Camera(Intrinsics.of_fov(40, 30, 1.1, 0.9), Pose(STEP, (1, 0, 0, 0)))
    reference = ReferencePicture(rng.random((30, 40, 3), dtype=np.float32), there, 0)
    return reference, depth, Camera(Intrinsics.of_fov(width, height, 1.0, 0.8), Pose.identity())


@settings(max_examples=60)
@given(scenes(), st.integers(0, 16), st.integers(0, 12), st.integers(1, 3))
def test_holes_are_filled_as_defined(
    scene: tuple[ReferencePicture, np.ndarray, Camera], radius: int, iterations: int, threads: int
) -> None:
    how = AlignSettings(erosion_radius_px=radius, erosion_iterations=iterations, threads=threads)
    defined, fast = (create(name, how).align(*scene, colours=True) for name in ("reference", "cpu"))
    np.testing.assert_array_equal(fast.occluded, defined.occluded)
    np.testing.assert_allclose(fast.confidence, defined.confidence, atol=1e-4)
    np.testing.assert_allclose(fast.rgb, defined.rgb, atol=2e-4)


@settings(max_examples=20)
@given(scenes())
def test_colours_asked_for_later_are_the_same(scene: tuple[ReferencePicture, np.ndarray, Camera]) -> None:
    aligner = create("cpu")
    at_once, later = (aligner.align(*scene, colours=colours) for colours in (True, False))
    np.testing.assert_array_equal(at_once.rgb, later.rgb)
    np.testing.assert_array_equal(at_once.confidence, later.confidence)
    np.testing.assert_array_equal(at_once.occluded, later.occluded)
