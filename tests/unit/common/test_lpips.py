"""LPIPS reproduces the published distances."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from cags_common.errors import ConfigError
from cags_common.lpips import Lpips

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
