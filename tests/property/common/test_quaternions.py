"""Quaternion maths on random rotations, half-turns included."""

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from cags_common.geometry import (
    angle_between,
    multiply_quaternions,
    normalise_quaternion,
    quaternion_of_matrix,
    quaternion_of_rotation_vector,
    rotation_matrix,
    rotation_vector,
)

component = st.floats(-1, 1)
quaternions = (
    st.tuples(component, component, component, component)
    .filter(lambda q: sum(c * c for c in q) > 1e-6)
    .map(normalise_quaternion)
)
half_turns = (
    st.tuples(component, component, component)
    .filter(lambda v: sum(c * c for c in v) > 1e-6)
    .map(lambda v: normalise_quaternion((0.0, *v)))
)


@given(quaternions | half_turns)
def test_matrix_round_trip_keeps_the_rotation(q):
    assert angle_between(quaternion_of_matrix(rotation_matrix(q)), q) < 1e-6


@given(quaternions | half_turns)
def test_matrices_are_rotations(q):
    matrix = rotation_matrix(q)
    assert np.allclose(matrix @ matrix.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(matrix) > 0


@given(quaternions | half_turns)
def test_logarithm_and_exponential_are_inverse(q):
    vector = rotation_vector(q)
    assert math.hypot(*vector) <= math.pi + 1e-9
    assert angle_between(quaternion_of_rotation_vector(vector), q) < 1e-6


@given(quaternions)
def test_q_and_minus_q_are_one_rotation(q):
    w, x, y, z = q
    negated = normalise_quaternion((-w, -x, -y, -z))
    assert negated[0] >= 0
    assert angle_between(negated, q) < 1e-6


@given(quaternions, quaternions)
def test_products_multiply_matrices(a, b):
    product = rotation_matrix(normalise_quaternion(multiply_quaternions(a, b)))
    assert np.allclose(product, rotation_matrix(a) @ rotation_matrix(b), atol=1e-9)
