"""Dynamic 3D Gaussians' params.npz."""

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from cags_common.errors import SceneError
from cags_common.splats import SH_C0
from cags_encoder.scenes import open_scene


def params(steps: int = 3, count: int = 20) -> dict[str, NDArray[Any]]:
    rng = np.random.default_rng(0)
    return {
        "means3D": rng.normal(size=(steps, count, 3)).astype(np.float32),
        "rgb_colors": rng.uniform(size=(steps, count, 3)).astype(np.float32),
        "unnorm_rotations": rng.normal(size=(steps, count, 4)).astype(np.float32),
        "seg_colors": np.zeros((count, 3), np.float32),
        "log_scales": rng.normal(-4, 1, (count, 3)).astype(np.float32),
        "logit_opacities": rng.normal(size=(count, 1)).astype(np.float32),
        "cam_m": np.zeros((4, 3), np.float32),
    }


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_steps_become_frames(save: Any, dtype: Any, tmp_path: Path) -> None:
    arrays = params()
    path = tmp_path / "basketball" / "params.npz"
    path.parent.mkdir()
    save(path, **{name: array.astype(dtype) for name, array in arrays.items()})
    scene = open_scene(str(path))
    assert (scene.name, len(scene), scene.up) == ("basketball", 3, (0, -1, 0))
    frame = scene.frame(2)
    np.testing.assert_allclose(frame.means, arrays["means3D"][2], atol=1e-6)
    np.testing.assert_allclose(0.5 + SH_C0 * frame.sh0, arrays["rgb_colors"][2], atol=1e-6)
    np.testing.assert_array_equal(frame.log_scales, scene.frame(0).log_scales)
    np.testing.assert_array_equal(scene.ids(1), np.arange(20))
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(scene)).frame(2).means, frame.means)
    assert len(open_scene(f"{path}:frames=8")) == 8


def test_a_single_step_is_a_still_scene(tmp_path: Path) -> None:
    np.savez(tmp_path / "params.npz", **{name: a[0] if a.ndim == 3 else a for name, a in params().items()})
    assert len(open_scene(f"{tmp_path}/params.npz")) == 1


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"means3D": None}, "lacks the array 'means3D'"),
        ({"means3D": np.zeros((3, 20, 2))}, r"means3D has shape \(3, 20, 2\)"),
        ({"means3D": np.zeros((4, 20, 3))}, "disagree"),
        ({"log_scales": np.zeros((21, 3))}, "disagree"),
        ({"log_scales": np.zeros((20, 3), np.int32)}, "holds '<i4'"),
        ({"log_scales": np.array([[None] * 3] * 20)}, "holds '\\|O'"),
        ({"means3D": np.full((3, 20, 3), np.nan)}, "step 0: means"),
        ({"unnorm_rotations": np.zeros((3, 20, 4))}, "zero"),
        (dict.fromkeys(("means3D", "rgb_colors", "unnorm_rotations"), np.zeros((3, 0, 3))), "shape|disagree|holds"),
    ],
)
def test_refusals(change: dict[str, Any], words: str, tmp_path: Path) -> None:
    arrays = {name: array for name, array in {**params(), **change}.items() if array is not None}
    np.savez(tmp_path / "params.npz", **arrays)
    with pytest.raises(SceneError, match=words):
        open_scene(f"{tmp_path}/params.npz")


def test_other_files_are_refused(tmp_path: Path) -> None:
    (tmp_path / "params.npz").write_bytes(b"not a zip")
    with pytest.raises(SceneError, match=r"is not an \.npz archive"):
        open_scene(f"{tmp_path}/params.npz")


def test_what_is_said_of_a_damaged_file_does_not_quote_it(tmp_path: Path) -> None:
    path = tmp_path / "params.npz"
    np.savez_compressed(path, **params(count=2000))
    data = bytearray(path.read_bytes())
    data[26:28] = b"\xff\x03"  # length of the first entry's name: zipfile quotes all of it
    path.write_bytes(data)
    with pytest.raises(SceneError, match="means3D' is damaged") as refused:
        open_scene(str(path))
    assert len(str(refused.value)) < len(str(path)) + 200
