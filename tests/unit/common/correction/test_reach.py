"""How much of a reference is used from how far away."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cags_common.correction.reach import LARGE_HOLDS, SMALL, apart, smallness, valid_share
from cags_common.geometry import Pose, Vec3, quaternion_of_rotation_vector

CENTRE = (0.0, 0.0, 4.0)
lengths = st.floats(-3, 3)
poses = st.builds(
    lambda position, turn: Pose(position, quaternion_of_rotation_vector(turn)),
    st.tuples(lengths, lengths, lengths),
    st.tuples(lengths, lengths, lengths),
)


def test_a_turn_counts_as_its_angle_and_a_step_as_that_which_the_scene_turns_by() -> None:
    here = Pose.identity()
    there = Pose((0.4, 0.0, 0.0), quaternion_of_rotation_vector((0.0, 0.2, 0.0)))
    assert apart(there, here, CENTRE, 1.0) == pytest.approx(0.2 + 0.1)
    assert apart(there, here, (0.0, 0.0, 0.1), 2.0) == pytest.approx(0.2 + 0.2), "within the scene its radius counts"


@given(poses, poses, st.tuples(lengths, lengths, lengths), st.floats(1e-3, 10))
def test_views_are_apart_unless_they_are_the_same(a: Pose, b: Pose, centre: Vec3, radius: float) -> None:
    assert apart(a, a, centre, radius) < 1e-6
    distance = apart(a, b, centre, radius)
    assert math.isfinite(distance)
    assert distance >= 0


@given(st.floats(0, 1e9), st.floats(0, 1e9), st.floats(0, 1), st.floats(0, 1))
def test_less_is_used_from_farther_away_and_of_smaller_differences(a: float, b: float, c: float, d: float) -> None:
    near, far = sorted((a, b))
    large, small = sorted((c, d))
    assert valid_share(0, small) == 1
    assert 0 <= valid_share(far, small) <= valid_share(near, small) <= 1
    if far <= LARGE_HOLDS:
        assert valid_share(far, small) <= valid_share(far, large)


def test_differences_are_small_up_to_44_db_and_large_from_41_db_on() -> None:
    assert smallness(SMALL / 2) == smallness(SMALL) == 1
    assert smallness(1.5 * SMALL) == pytest.approx(0.5)
    assert smallness(2 * SMALL) == smallness(1) == 0
    assert smallness(0) == 0, "a server that does not tell"
