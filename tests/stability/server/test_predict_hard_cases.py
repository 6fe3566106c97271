"""What real clients, networks and hostile ones send: every predictor stays finite, unit and sensible."""

import math

import pytest

from cags_common.geometry import Pose, angle_between, quaternion_of_rotation_vector
from cags_protocol.wire.messages import PoseSample
from cags_server.predict import PREDICTORS, PoseHistory, create_predictor
from cags_server.predict.base import PoseDistribution
from support.motion import history_of, swaying_pose, turning_pose

HORIZONS_US = (0, 1, 33_333, 200_000, 1_000_000, 10**12)

pytestmark = pytest.mark.parametrize("name", list(PREDICTORS))


def predictions(name: str, history: PoseHistory) -> list[PoseDistribution]:
    """Predictions at every horizon, each checked to be a finite pose with a finite uncertainty."""
    out = [create_predictor(name).predict(history, horizon) for horizon in HORIZONS_US]
    for each in out:
        numbers = (*each.pose.position, *each.pose.rotation, *each.rotation_std_rad, *each.position_std_m)
        assert all(math.isfinite(number) for number in numbers)
        assert math.hypot(*each.pose.rotation) == pytest.approx(1.0, abs=1e-9)
        assert each.pose.rotation[0] >= 0
        assert min(*each.rotation_std_rad, *each.position_std_m) >= 0
    return out


def test_all_poses_equal(name: str) -> None:
    pose = turning_pose(700_000)
    for each in predictions(name, history_of(lambda _: pose)):
        assert angle_between(each.pose.rotation, pose.rotation) < 1e-7
        assert each.pose.position == pytest.approx(pose.position, abs=1e-12)


@pytest.mark.parametrize("count", range(1, 20))
def test_few_poses(name: str, count: int) -> None:
    predictions(name, PoseHistory(PoseSample(t * 20_000, swaying_pose(t * 20_000)) for t in range(count)))


def test_a_gap_of_ten_seconds_forgets_the_motion_before_it(name: str) -> None:
    history = history_of(turning_pose, 1_000_000)
    history.add(PoseSample(11_000_000, turning_pose(5)))
    for each in predictions(name, history):
        assert angle_between(each.pose.rotation, turning_pose(5).rotation) < 1e-7


def test_a_jump_cut_is_not_a_motion(name: str) -> None:
    history = history_of(lambda t: turning_pose(t, rad_s=0.05, m_s=0.02), 1_000_000)
    there = Pose((40.0, 2.0, 7.0), (0.0, 0.0, 1.0, 0.0))
    history.add(PoseSample(1_015_000, there))
    for each in predictions(name, history):
        assert math.dist(each.pose.position, there.position) < 1e-9


def test_time_running_backwards_is_put_in_order(name: str) -> None:
    times = list(range(0, 2_000_000, 27_000))
    backwards = PoseHistory(PoseSample(t, swaying_pose(t)) for t in reversed(times))
    forwards = PoseHistory(PoseSample(t, swaying_pose(t)) for t in times)
    assert predictions(name, backwards) == predictions(name, forwards)


def test_half_turns_between_samples(name: str) -> None:
    """A headset worn the wrong way round, or a client that mixes two cameras."""

    def flipping(t: int) -> Pose:
        return Pose((0.0, 1.6, 0.0), quaternion_of_rotation_vector((0.0, math.pi * (t // 50_000 % 2), 0.0)))

    predictions(name, history_of(flipping, 2_000_000, period_us=50_000))


@pytest.mark.parametrize("period_us", [1_000, 4_167, 100_000, 200_000])
def test_any_sample_rate(name: str, period_us: int) -> None:
    history = history_of(swaying_pose, 3_000_000, period_us=period_us)
    predictions(name, history)
    t = history.newest.t_us + 100_000
    predicted = create_predictor(name).predict(history, 100_000).pose
    held = angle_between(history.newest.pose.rotation, swaying_pose(t).rotation)
    assert angle_between(predicted.rotation, swaying_pose(t).rotation) <= 1.05 * held + 0.01


def test_duplicated_missing_and_jittered_samples(name: str) -> None:
    history = PoseHistory()
    for i, t in enumerate(range(0, 3_000_000, 14_000)):
        if i % 7 in (2, 3):
            continue
        jittered = t + (i * 7919) % 5_000
        for _ in range(1 + i % 3):
            history.add(PoseSample(jittered, swaying_pose(jittered)))
    predictions(name, history)
    t = history.newest.t_us + 200_000
    predicted = create_predictor(name).predict(history, 200_000).pose
    assert angle_between(predicted.rotation, swaying_pose(t).rotation) < 0.25


def test_a_motion_along_one_line_is_rank_deficient_and_harmless(name: str) -> None:
    def on_a_line(t: int) -> Pose:
        return Pose((1e-6 * t, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0))

    history = history_of(on_a_line)
    for each in predictions(name, history):
        assert abs(each.pose.position[1]) + abs(each.pose.position[2]) < 0.5
        assert angle_between(each.pose.rotation, (1.0, 0.0, 0.0, 0.0)) < 0.3


def test_full_circles_are_followed_through_the_change_of_sign(name: str) -> None:
    """w passes through zero and the canonical sign flips: prediction must not notice."""
    errors = []
    for end in range(2_000_000, 9_000_000, 250_000):
        history = history_of(lambda t: turning_pose(t, rad_s=2.0), end)
        t = history.newest.t_us + 100_000
        predicted = create_predictor(name).predict(history, 100_000).pose
        errors.append(angle_between(predicted.rotation, turning_pose(t, rad_s=2.0).rotation))
    assert max(errors) - min(errors) < 0.01


def test_huge_coordinates(name: str) -> None:
    def far(t: int) -> Pose:
        near = swaying_pose(t)
        return Pose((near.position[0] + 1e7, near.position[1] - 1e7, near.position[2]), near.rotation)

    predictions(name, history_of(far))


def test_numbers_that_are_not_finite_never_enter_a_history(name: str) -> None:
    for bad in (math.nan, math.inf):
        with pytest.raises(ValueError, match="finite"):
            Pose((0.0, bad, 0.0), (1.0, 0.0, 0.0, 0.0))
        with pytest.raises(ValueError, match="direction"):
            Pose((0.0, 0.0, 0.0), (bad, 0.0, 0.0, 0.0))
