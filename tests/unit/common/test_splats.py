"""Splats from outside are checked by name and index."""

from dataclasses import replace

import numpy as np
import pytest

from cags_common.errors import DecodeError, SceneError
from cags_common.splats import Splats


def some_splats(n: int = 5, coefficients: int = 3) -> Splats:
    rng = np.random.default_rng(0)
    shapes = {
        "means": (n, 3),
        "quats": (n, 4),
        "log_scales": (n, 3),
        "logit_opacities": (n,),
        "sh0": (n, 3),
        "sh_rest": (n, coefficients, 3),
    }
    return Splats(**{name: rng.normal(size=shape).astype(np.float32) for name, shape in shapes.items()})


def test_checked_normalises_quaternions_and_keeps_the_rest():
    splats = some_splats()
    checked = splats.checked("here")
    assert np.allclose(np.linalg.norm(checked.quats, axis=1), 1)
    assert (checked.quats[:, 0] >= 0).all()
    assert np.array_equal(checked.means, splats.means)


@pytest.mark.parametrize("name", ["means", "quats", "log_scales", "logit_opacities", "sh0", "sh_rest"])
def test_nan_is_refused_by_name_and_index(name):
    splats = some_splats()
    array = getattr(splats, name).copy()
    array[3] = np.nan
    with pytest.raises(SceneError, match=rf"file\.ply: {name}\[3\](\[0\])* = nan is not finite; repair"):
        replace(splats, **{name: array}).checked("file.ply")


def test_infinite_opacity_is_saturated_not_refused():
    splats = some_splats()
    logits = splats.logit_opacities.copy()
    logits[:2] = np.inf, -np.inf
    assert replace(splats, logit_opacities=logits).checked("x").logit_opacities[:2].tolist() == [20.0, -20.0]


def test_zero_quaternions_are_refused():
    splats = some_splats()
    quats = splats.quats.copy()
    quats[1] = 0
    with pytest.raises(SceneError, match=r"quats\[1\] is zero"):
        replace(splats, quats=quats).checked("x")


def test_wrong_shapes_are_refused():
    splats = some_splats()
    with pytest.raises(SceneError, match=r"sh0 has shape \(4, 3\), expected \(5, 3\)"):
        replace(splats, sh0=splats.sh0[:4]).checked("x")
    with pytest.raises(SceneError, match="sh_rest has shape"):
        replace(splats, sh_rest=np.zeros((5, 4, 3), np.float32)).checked("x")


def test_no_splats_are_refused():
    with pytest.raises(SceneError, match="holds no splats"):
        some_splats().take(np.array([], dtype=int)).checked("x")


def test_take_and_concatenate_are_inverse():
    splats = some_splats()
    again = Splats.concatenate([splats.take(slice(0, 2)), splats.take(np.array([2, 3, 4]))])
    for (name, a), (_, b) in zip(splats.arrays(), again.arrays(), strict=True):
        assert np.array_equal(a, b), name
    assert splats.sh_degree == 1


@pytest.mark.parametrize("coefficients", [0, 3])
def test_values_are_written_to_their_place(coefficients):
    splats = some_splats(5, coefficients)
    whole = Splats.unwritten(12, splats.sh_degree)
    for _, array in whole.arrays():
        array[...] = 7.0
    place = whole.span(4, 9)
    assert splats.written_to(place) is place
    for (name, array), (_, values) in zip(whole.arrays(), splats.arrays(), strict=True):
        assert array.dtype == np.float32 and array.flags.c_contiguous, name
        assert np.array_equal(array[4:9], values), name
        assert (array[:4] == 7).all() and (array[9:] == 7).all(), name
    assert splats.written_to(None) is splats


def test_a_place_of_another_sh_degree_is_refused():
    with pytest.raises(DecodeError, match="SH degree 1, their place 0"):
        some_splats(2, 3).written_to(Splats.unwritten(2, 0))


@pytest.mark.parametrize(("column", "value"), [("means", 1e30), ("sh0", 1e16), ("sh_rest", -1e21)])
def test_values_whose_squares_overflow_are_refused(column, value):
    arrays = {name: array.copy() for name, array in some_splats().arrays()}
    arrays[column].reshape(5, -1)[2, 0] = value
    with pytest.raises(SceneError, match=rf"{column}\[2\](\[0\])+ = [-+\de]+ lies beyond 1e.*repair=drop"):
        Splats(**arrays).checked("far.ply")
