"""The rotation group in bulk agrees with the scalar functions and with the group's laws."""

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from cags_common import so3
from cags_common.geometry import angle_between, quaternion_of_rotation_vector, rotation_matrix

component = st.floats(-3.0, 3.0)
vectors = st.tuples(component, component, component)


@given(vectors)
def test_exp_agrees_with_the_scalar_one(v: tuple[float, float, float]) -> None:
    assert angle_between(tuple(so3.exp(np.array(v)).tolist()), quaternion_of_rotation_vector(v)) < 1e-7


@given(vectors)
def test_log_undoes_exp_within_half_a_turn(v: tuple[float, float, float]) -> None:
    angle = math.hypot(*v)
    scaled = np.array(v) if angle < 3.1 else np.array(v) * (3.1 / angle)
    assert so3.log(so3.exp(scaled)) == pytest.approx(scaled, abs=1e-7)
    assert so3.log(-so3.exp(scaled)) == pytest.approx(scaled, abs=1e-7)


@given(vectors, vectors)
def test_rotate_is_the_matrix(v: tuple[float, float, float], x: tuple[float, float, float]) -> None:
    q = quaternion_of_rotation_vector(v)
    assert so3.rotate(np.array(q), np.array(x)) == pytest.approx(rotation_matrix(q) @ np.array(x), abs=1e-9)


@given(vectors, vectors, st.floats(0, 1))
def test_slerp_moves_along_the_shorter_arc(a: tuple, b: tuple, f: float) -> None:
    qa, qb = so3.exp(np.array([a])), so3.exp(np.array([b]))
    whole = np.linalg.norm(so3.log(so3.multiply(so3.conjugate(qa), qb)))
    assume(whole < math.pi - 1e-3)  # at half a turn both arcs are the shorter one
    part = np.linalg.norm(so3.log(so3.multiply(so3.conjugate(qa), so3.slerp(qa, qb, np.array([f])))))
    assert part == pytest.approx(f * whole, abs=1e-6)
