import itertools

import pytest

from cags_common.geometry import Pose, angle_between
from cags_protocol.wire.messages import PoseSample
from cags_server.predict import PoseHistory
from cags_server.predict.history import CLOCK_RESTART_SAMPLES, HISTORY_US, MAX_SAMPLES
from support.motion import PERIOD_US, history_of, swaying_pose, turning_pose


def test_order_of_arrival_does_not_matter() -> None:
    samples = [PoseSample(t, swaying_pose(t)) for t in range(0, 1_000_000, PERIOD_US)]
    mixed = PoseHistory(samples[1::2] + samples[::2])
    for a, b in zip(PoseHistory(samples).segment(), mixed.segment(), strict=True):
        assert (a == b).all()


def test_a_repeated_time_replaces_the_pose() -> None:
    history = PoseHistory([PoseSample(10, Pose.identity()), PoseSample(10, turning_pose(500_000))])
    assert len(history) == 1
    assert history.newest.pose == turning_pose(500_000)


def test_old_samples_are_let_go() -> None:
    history = history_of(turning_pose, 3 * HISTORY_US)
    assert len(history) <= HISTORY_US // PERIOD_US + 1


def test_the_number_of_samples_is_bounded() -> None:
    history = PoseHistory(PoseSample(t, Pose.identity()) for t in range(0, 3 * MAX_SAMPLES))
    assert len(history) == MAX_SAMPLES


def test_a_gap_starts_a_new_segment() -> None:
    history = history_of(turning_pose, 1_000_000)
    history.add(PoseSample(11_000_000, turning_pose(0)))
    times, _, _ = history.segment()
    assert times.tolist() == [11_000_000]


@pytest.mark.parametrize("cut", [Pose((90.0, 1.6, 0.0), (1, 0, 0, 0)), Pose((1.0, 1.6, 0.0), (0, 0, 1, 0))])
def test_a_cut_starts_a_new_segment(cut: Pose) -> None:
    history = history_of(lambda t: turning_pose(t, rad_s=0.1, m_s=0.1), 1_000_000)
    history.add(PoseSample(1_020_000, cut))
    assert len(history.segment()[0]) == 1


def test_five_hertz_input_stays_connected() -> None:
    assert len(history_of(swaying_pose, 2_000_000, period_us=200_000).segment()[0]) == 11


def test_one_stray_sample_of_the_past_is_ignored_but_a_clock_set_back_is_followed() -> None:
    history = history_of(turning_pose, 9_000_000, start_us=8_000_000)
    history.add(PoseSample(5, Pose.identity()))
    assert history.newest.t_us > 8_000_000
    for t in range(CLOCK_RESTART_SAMPLES):
        history.add(PoseSample(100 + t * PERIOD_US, turning_pose(t * PERIOD_US)))
    assert history.newest.t_us == 100 + (CLOCK_RESTART_SAMPLES - 1) * PERIOD_US


def test_the_grid_interpolates_and_ends_at_the_newest_sample() -> None:
    history = history_of(turning_pose, 1_000_000)
    positions, rotations = history.on_grid(33_333, 11)
    assert len(positions) == len(rotations) == 11
    for i in range(11):
        expected = turning_pose(history.newest.t_us - (10 - i) * 33_333)
        assert tuple(positions[i]) == pytest.approx(expected.position)
        assert angle_between(tuple(rotations[i]), expected.rotation) < 1e-6


def test_a_pose_between_samples_is_interpolated_and_beyond_them_unknown() -> None:
    history = history_of(turning_pose, 1_000_000)
    between = history.pose_at(500_123)
    assert between is not None
    assert angle_between(between.rotation, turning_pose(500_123).rotation) < 1e-6
    assert history.pose_at(2_000_000) is None
    assert history.pose_at(-5) is None
    assert history.pose_at(PERIOD_US) == turning_pose(PERIOD_US)


def test_sign_of_quaternions_does_not_matter() -> None:
    """Headsets report either sign; a pose keeps w >= 0, which flips between neighbours near half a turn."""
    history = history_of(lambda t: turning_pose(t + 3_000_000, rad_s=1.0), 400_000)
    _, rotations = history.on_grid(33_333, 10)
    steps = [angle_between(tuple(a), tuple(b)) for a, b in itertools.pairwise(rotations)]
    assert max(steps) == pytest.approx(0.033333, rel=1e-3)
