"""Margins from uncertainty and from the LSTM."""

import numpy as np
import pytest

from cags_common.errors import ConfigError
from cags_common.geometry import Intrinsics, Pose
from cags_server.fov import FovObservation, create_fov_policy
from cags_server.fov.lstm import INPUTS, LstmFov, LstmWeights
from cags_server.fov.quantile import QuantileFov
from cags_server.predict import PoseDistribution, create_predictor
from support.motion import history_of, swaying_pose

CLIENT = Intrinsics.of_fov(1600, 1200, 1.48, 1.20)


def observed(frame: int, pose: Pose, std: float = 0.05) -> FovObservation:
    return FovObservation(frame, PoseDistribution(pose, (std,) * 3, (std,) * 3), CLIENT)


def test_a_sure_prediction_needs_no_margin() -> None:
    assert QuantileFov(0.9).scale(observed(0, Pose.identity(), 0.0)) == (0, 0)


def test_margins_grow_with_uncertainty_and_quantile() -> None:
    small = QuantileFov(0.9).scale(observed(0, Pose.identity(), 0.01))
    large = QuantileFov(0.9).scale(observed(0, Pose.identity(), 0.02))
    surer = QuantileFov(0.99).scale(observed(0, Pose.identity(), 0.02))
    assert 0 < small[0] < large[0] < surer[0]
    assert 0 < small[1] < large[1] < surer[1]


def test_yaw_widens_the_sides_and_pitch_the_height() -> None:
    yaw = PoseDistribution(Pose.identity(), (0.0, 0.1, 0.0), (0.0,) * 3)
    pitch = PoseDistribution(Pose.identity(), (0.1, 0.0, 0.0), (0.0,) * 3)
    assert QuantileFov(0.9).scale(FovObservation(0, yaw, CLIENT))[1] == 0
    assert QuantileFov(0.9).scale(FovObservation(0, pitch, CLIENT))[0] == 0


@pytest.mark.parametrize("quantile", [0.0, 1.0, -1.0])
def test_a_quantile_lies_between_zero_and_one(quantile: float) -> None:
    with pytest.raises(ValueError, match="quantile"):
        QuantileFov(quantile)


def test_who_stands_still_gets_nearly_no_margin_from_the_quantile() -> None:
    pose = swaying_pose(123)
    distribution = create_predictor("autoregressive").predict(history_of(lambda _: pose), 200_000)
    assert max(QuantileFov(0.9).scale(FovObservation(0, distribution, CLIENT))) < 1e-6


def test_who_stands_still_gets_nearly_no_margin_from_the_lstm() -> None:
    policy, pose = LstmFov(gain=0.7), swaying_pose(123)
    for i in range(60):
        if i >= 6:
            policy.truth(i - 6, pose, pose, CLIENT)
        margins = policy.scale(observed(i, pose))
    assert max(margins) < 0.02


def run(policy: LstmFov, frames: int = 60, lead: int = 6) -> list[tuple[float, float]]:
    """A stream: frame i is planned ``lead`` frames before its true pose is known, and predicted by holding."""
    out = []
    for i in range(frames):
        if i >= lead:
            old = i - lead
            policy.truth(old, swaying_pose((old - lead) * 33_333), swaying_pose(old * 33_333), CLIENT)
        out.append(policy.scale(observed(i, swaying_pose((i - lead) * 33_333))))
    return out


def test_the_shipped_lstm_gives_sane_margins_and_says_how_it_was_made() -> None:
    margins = np.array(run(LstmFov()))
    assert np.isfinite(margins).all()
    assert (margins >= 0).all()
    assert (margins < 2).all()
    assert LstmWeights.load().provenance["command"].startswith("cags-train fov")


def test_the_lstm_is_deterministic_and_its_gain_scales_it() -> None:
    plain, again, double = run(LstmFov()), run(LstmFov()), run(LstmFov(gain=2.0))
    assert plain == again
    assert np.allclose(np.array(double), 2 * np.array(plain))


def test_the_lstm_does_not_depend_on_the_sign_of_quaternions_or_the_origin() -> None:
    def shifted(t: int) -> Pose:
        pose = swaying_pose(t)
        return Pose(tuple(np.add(pose.position, (64.0, -32.0, 16.0)).tolist()), pose.rotation)

    policies = LstmFov(), LstmFov()
    for policy, pose_of in zip(policies, (swaying_pose, shifted), strict=True):
        for i in range(30):
            policy.truth(i, pose_of(i * 33_333 - 200_000), pose_of(i * 33_333), CLIENT)
    a, b = (p.scale(observed(36, f(1_200_000))) for p, f in zip(policies, (swaying_pose, shifted), strict=True))
    assert a == pytest.approx(b, abs=1e-3)


def test_the_roll_out_is_bounded_while_no_truth_arrives() -> None:
    policy = LstmFov()
    for i in range(200):
        margins = policy.scale(observed(i, swaying_pose(i * 33_333)))
    assert len(policy._pending) <= 64
    assert all(np.isfinite(margins))


def test_a_seek_starts_the_roll_out_again() -> None:
    policy = LstmFov()
    for i in (10, 11, 12, 3):
        policy.scale(observed(i, swaying_pose(i * 33_333)))
    assert list(policy._pending) == [3]


def test_damaged_weights_are_refused(tmp_path) -> None:
    path = tmp_path / "lstm.npz"
    path.write_bytes(b"not weights")
    with pytest.raises(ConfigError, match=r"lstm\.npz"):
        LstmWeights.load(path)
    good = LstmWeights.load()
    bad = LstmWeights(good.w_input[:, :-1], *(getattr(good, n) for n in ("w_hidden", "bias", "w_out", "b_out")),
                      good.mean, good.scale, {})  # fmt: skip
    bad.save(path)
    with pytest.raises(ConfigError, match="w_input"):
        LstmWeights.load(path)
    assert good.w_input.shape[1] == INPUTS


def test_policies_are_made_by_name() -> None:
    for name in ("fixed", "quantile", "lstm"):
        x, y = create_fov_policy(name).scale(observed(0, swaying_pose(0)))
        assert 0 <= x < 3
        assert 0 <= y < 3
