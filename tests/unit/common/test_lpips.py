"""LPIPS reproduces the published distances."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from cags_common.errors import ConfigError
from cags_common.lpips import CONVOLUTIONS, EPSILON, POOLED_BEFORE, SCALE, SHIFT, Lpips

PARTS = ("conv", "weight"), ("conv", "bias"), ("lin", "weight")
SHARED = Path(__file__).parents[4] / "shared" / "lpips"
needs_weights = pytest.mark.skipif(
    not SHARED.exists(), reason="the LPIPS weights beside the checkout (../shared/lpips) are absent"
)


def picture(name: str) -> np.ndarray:
    return cv2.imread(str(SHARED / "ref_images" / f"{name}.png"))[..., ::-1].astype(np.float32) / 255


@needs_weights
@pytest.mark.parametrize(("other", "expected"), [("ex_p0", 0.7219), ("ex_p1", 0.1376), ("ex_ref", 0.0)])
def test_distances_of_the_published_example(other, expected):
    lpips = Lpips(SHARED / "lpips_alex.npz")
    assert lpips.distance(picture("ex_ref"), picture(other)) == pytest.approx(expected, abs=1e-4)


@needs_weights
def test_pictures_of_unequal_or_tiny_size_are_refused():
    lpips = Lpips(SHARED / "lpips_alex.npz")
    with pytest.raises(ValueError, match="equal in size"):
        lpips.distance(np.zeros((40, 40, 3), np.float32), np.zeros((40, 41, 3), np.float32))
    with pytest.raises(ValueError, match="31 px"):
        lpips.distance(np.zeros((8, 8, 3), np.float32), np.zeros((8, 8, 3), np.float32))


def test_the_network_is_that_which_torch_runs(tmp_path):
    """Of random weights and pictures of odd sizes."""
    torch = pytest.importorskip("torch")
    functional = torch.nn.functional
    rng = np.random.default_rng(5)
    sizes = [(8, 3, 11), (12, 8, 5), (16, 12, 3), (10, 16, 3), (9, 10, 3)]
    arrays = {}
    for i, (out, into, kernel) in enumerate(sizes):
        arrays[f"conv{i}.weight"] = rng.normal(0, (into * kernel**2) ** -0.5, (out, into, kernel, kernel)).astype("f")
        arrays[f"conv{i}.bias"] = rng.normal(0, 0.1, out).astype("f")
        arrays[f"lin{i}.weight"] = rng.random((1, out, 1, 1)).astype("f")
    np.savez(tmp_path / "w.npz", **arrays)
    pictures = rng.random((2, 67, 90, 3)).astype("f")

    x = torch.from_numpy(pictures).permute(0, 3, 1, 2) * 2 - 1
    x = (x - torch.tensor(SHIFT).reshape(1, 3, 1, 1)) / torch.tensor(SCALE).reshape(1, 3, 1, 1)
    expected = 0.0
    for i, (stride, padding) in enumerate(CONVOLUTIONS):
        x = functional.max_pool2d(x, 3, 2) if i in POOLED_BEFORE else x
        weight, bias, linear = (torch.from_numpy(arrays[f"{n}{i}.{part}"]) for n, part in PARTS)
        x = functional.relu(functional.conv2d(x, weight, bias, stride=stride, padding=padding))
        unit = x / (x.square().sum(1, keepdim=True).sqrt() + EPSILON)
        expected += float(((unit[0] - unit[1]).square() * linear[0]).sum(0).mean())
    assert Lpips(tmp_path / "w.npz").distance(*pictures) == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize("content", [None, b"", b"PK\x03\x04 not really", b"\x93NUMPY"])
def test_other_files_are_refused_by_name(tmp_path, content):
    path = tmp_path / "weights.npz"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(ConfigError, match=r"weights\.npz: is not an LPIPS weights file"):
        Lpips(path)


def test_an_archive_without_the_layers_is_refused(tmp_path):
    np.savez(tmp_path / "w.npz", other=np.zeros(3))
    with pytest.raises(ConfigError, match=r"conv0\.weight"):
        Lpips(tmp_path / "w.npz")
