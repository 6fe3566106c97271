import numpy as np
import pytest

from cags_common import so3
from cags_common.errors import ConfigError
from cags_server.predict.pooled import HORIZON_STEPS, ORDERS, PooledWeights, displacements, windows
from support.motion import swaying_pose


def grid(count: int = 40) -> tuple[np.ndarray, np.ndarray]:
    poses = [swaying_pose(i * 33_333) for i in range(count)]
    return np.array([p.rotation for p in poses]), np.array([p.position for p in poses])


def test_windows_are_newest_first_and_in_the_axes_of_the_newest_camera() -> None:
    rotations, positions = grid()
    rows = windows(rotations, positions, 4)
    assert rows.shape == (36, 24)
    newest = rows[-1].reshape(4, 6)
    step = so3.log(so3.multiply(so3.conjugate(rotations[-2]), rotations[-1]))
    assert newest[0, :3] == pytest.approx(step)
    assert so3.rotate(rotations[-1], newest[1, 3:]) == pytest.approx(positions[-2] - positions[-3])


def test_windows_do_not_change_when_the_world_is_turned() -> None:
    rotations, positions = grid()
    by = so3.exp(np.array([0.3, -1.2, 0.7]))
    turned = so3.multiply(by, rotations), so3.rotate(np.broadcast_to(by, (len(positions), 4)), positions)
    assert windows(*turned, 8) == pytest.approx(windows(rotations, positions, 8), abs=1e-9)
    assert displacements(*turned, 8, 6) == pytest.approx(displacements(rotations, positions, 8, 6), abs=1e-9)


def test_a_short_motion_has_no_window() -> None:
    rotations, positions = grid(4)
    assert windows(rotations, positions, 4).shape == (0, 24)
    weights = PooledWeights.load()
    assert [weights.order_for(n) for n in (0, 1, 3, 11, 500)] == [0, 1, 2, 8, 12]


def test_horizons_between_are_interpolated_and_zero_predicts_nothing() -> None:
    weights = PooledWeights.load()
    assert not weights.at(4, 0.0).any()
    assert weights.at(4, 2.5) == pytest.approx((weights.at(4, 2.0) + weights.at(4, 3.0)) / 2)
    assert weights.at(12, 1000.0) == pytest.approx(weights.matrices[12][-1])
    for i, steps in enumerate(HORIZON_STEPS):
        assert weights.at(1, float(steps)) == pytest.approx(weights.matrices[1][i])


def test_the_shipped_weights_say_how_they_were_made() -> None:
    provenance = PooledWeights.load().provenance
    assert provenance["command"].startswith("cags-train predictor")
    assert not any(name.endswith(("09", "10", "11", "12")) for name in provenance["data"])


def test_weights_survive_saving(tmp_path) -> None:
    path = tmp_path / "w.npz"
    weights = PooledWeights({order: np.ones((len(HORIZON_STEPS), 6 * order, 6)) for order in ORDERS}, {"a": 1})
    weights.save(path)
    again = PooledWeights.load(path)
    assert again.provenance == {"a": 1}
    assert all((again.matrices[order] == 1).all() for order in ORDERS)


def test_damaged_weights_are_refused(tmp_path) -> None:
    path = tmp_path / "w.npz"
    path.write_bytes(b"PK\x03\x04 nonsense")
    with pytest.raises(ConfigError, match=r"w\.npz"):
        PooledWeights.load(path)
    with pytest.raises(ConfigError, match="missing"):
        PooledWeights.load(tmp_path / "missing.npz")
