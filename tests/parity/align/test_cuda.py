"""Alignment for a CUDA device: by torch on the CPU everywhere, on the device where there is one."""

import numpy as np
import pytest
import torch

from cags_client.align import AlignSettings, ReferencePicture, create
from cags_client.align.cuda import CudaAligner
from cags_common.errors import ConfigError
from cags_common.geometry import Camera, Intrinsics, Pose

HERE = Camera(Intrinsics.of_fov(203, 151, 1.0, 0.8), Pose.identity())
THERE = Camera(Intrinsics.of_fov(67, 50, 1.2, 1.0), Pose((-0.28, 0.05, 0.02), (0.999, 0.01, -0.04, 0.0)))
SETTINGS = [AlignSettings(), AlignSettings(erosion_radius_px=5, erosion_iterations=2), AlignSettings(border_px=0.0)]


def scene() -> tuple[ReferencePicture, np.ndarray]:
    """Plates and a hole before a slanted wall, under a reference a step to the side."""
    rng = np.random.default_rng(7)
    depth = np.tile(np.linspace(2.5, 4.0, 203, dtype=np.float32), (151, 1))
    for _ in range(12):
        top, left = rng.integers(0, 130), rng.integers(0, 180)
        depth[top : top + 20, left : left + 25] = rng.uniform(0.8, 2.0)
    depth[60:70, 90:120] = np.inf
    return ReferencePicture(rng.random((50, 67, 3), dtype=np.float32), THERE, 0), depth


@pytest.mark.parametrize("settings", SETTINGS)
@pytest.mark.parametrize(
    "device",
    [
        "cpu",
        pytest.param(
            "cuda",
            marks=[pytest.mark.gpu, pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")],
        ),
    ],
)
def test_it_matches_the_definition(device: str, settings: AlignSettings) -> None:
    reference, depth = scene()
    right = create("reference", settings).align(reference, depth, HERE)
    ours = CudaAligner(settings, device).align(reference, depth, HERE, colours=True)
    assert 300 < right.occluded.sum() < right.occluded.size / 2
    same = ours.occluded == right.occluded
    assert same.mean() > 0.9999
    np.testing.assert_allclose(ours.confidence[same], right.confidence[same], atol=1e-4)
    assert (np.abs(ours.rgb - right.rgb).max(axis=2) < 2e-4).mean() > 0.999
    later = CudaAligner(settings, device).align(reference, depth, HERE).rgb
    np.testing.assert_array_equal(later, ours.rgb)


@pytest.mark.skipif(torch.cuda.is_available(), reason="a CUDA device is at hand")
def test_without_a_device_it_says_so() -> None:
    with pytest.raises(ConfigError, match=r"'cuda' needs a CUDA device .*; use 'auto'"):
        create("cuda")
