"""Weights files: exact, deterministic, and refused when they are anything else."""

import io
import json
import zipfile

import numpy as np
import pytest

from cags_common.errors import ConfigError
from cags_research.restore.networks import from_weights, network_of
from cags_research.restore.networks.weights import MAX_FILE_BYTES, Weights

ARRAYS = {"a.weight": np.arange(6, dtype=np.float32).reshape(2, 3), "b": np.zeros(2, np.float32)}


def archive(about, **arrays):
    out = io.BytesIO()
    np.savez(out, about=np.frombuffer(json.dumps(about).encode(), np.uint8), **arrays)
    return out.getvalue()


def test_round_trip(tmp_path):
    Weights("srresnet", ARRAYS, {"command": "x", "best": {"gain_db": 1.5}}).save(tmp_path / "w.npz")
    back = Weights.load(tmp_path / "w.npz")
    assert back.network == "srresnet"
    assert back.about == {"command": "x", "best": {"gain_db": 1.5}}
    assert back.count == 8
    for name, array in ARRAYS.items():
        np.testing.assert_array_equal(back.arrays[name], array)


def test_equal_weights_give_equal_bytes():
    reversed_order = dict(reversed(ARRAYS.items()))
    assert Weights("srresnet", ARRAYS, {}).to_bytes() == Weights("srresnet", reversed_order, {}).to_bytes()


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (b"", "no weights file"),
        (b"not a zip at all", "no weights file"),
        (Weights("srresnet", ARRAYS, {}).to_bytes()[:-30], "no weights file"),
        (b"\0" * (MAX_FILE_BYTES + 1), "more than a weights file"),
        (archive({"version": 1}), "which network"),
        (archive([1, 2]), "which network"),
        (archive({"version": 9, "network": "srresnet"}), "version 9"),
        (archive({"version": 1, "network": "srresnet"}, a=np.zeros(2)), "float32"),
        (archive({"version": 1, "network": "srresnet"}, a=np.float32([np.nan])), "finite"),
    ],
)
def test_anything_else_is_refused(data, says):
    with pytest.raises(ConfigError, match=says) as caught:
        Weights.from_bytes(data, "w.npz")
    assert str(caught.value).startswith("w.npz")


def test_pickled_arrays_are_refused():
    out = io.BytesIO()
    np.savez(out, about=np.array([{"network": "srresnet"}], dtype=object))
    with pytest.raises(ConfigError, match="no weights file"):
        Weights.from_bytes(out.getvalue(), "w.npz")


def test_archives_that_unpack_to_too_much_are_refused():
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("about.npy", b"\0" * (2 * MAX_FILE_BYTES))
    with pytest.raises(ConfigError, match="too much"):
        Weights.from_bytes(out.getvalue(), "bomb.npz")


def test_an_array_that_claims_more_than_its_bytes_is_refused_before_anything_is_allocated():
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f4", "fortran_order": False, "shape": (2**34,)})
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as file:
        file.writestr("a.npy", header.getvalue())
    with pytest.raises(ConfigError, match="no weights file"):  # numpy.load asks the system for 64 GiB
        Weights.from_bytes(out.getvalue(), "w.npz")


def test_missing_file_is_named(tmp_path):
    with pytest.raises(ConfigError, match=r"none\.npz"):
        Weights.load(tmp_path / "none.npz")


def test_weights_must_fit_their_network():
    with pytest.raises(ConfigError, match="missing, unknown or of another shape"):
        network_of(Weights("srresnet", ARRAYS, {}))
    with pytest.raises(ConfigError, match="'other'"):
        from_weights(Weights("other", ARRAYS, {}))
