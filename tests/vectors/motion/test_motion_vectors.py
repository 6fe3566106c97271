"""Chunks of motion of every format that this program reads decode to the numbers they were written down with."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np
import pytest

import cags_kernels

HERE = Path(__file__).parent
FILES = sorted(HERE.glob("v*.npz"))
_spec = importlib.util.spec_from_file_location("motion_vectors_make", HERE / "make.py")
assert _spec is not None and _spec.loader is not None
make = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(make)


def names_of(path: Path) -> list[str]:
    with np.load(path) as file:
        return sorted({key.split("/")[0] for key in file.files})


CASES = [(path, name) for path in FILES for name in names_of(path)]
WAYS = [False, True] if cags_kernels.native_available() else [False]


def recorded(path: Path, name: str) -> tuple[list[bytes], dict[str, np.ndarray]]:
    with np.load(path) as file:
        arrays = {key.split("/")[1]: file[key] for key in file.files if key.startswith(f"{name}/")}
    payloads = [arrays.pop(key).tobytes() for key in sorted(arrays) if key.startswith("payload-")]
    return payloads, arrays


def test_there_are_vectors() -> None:
    assert CASES


@pytest.mark.parametrize("native", WAYS)
@pytest.mark.parametrize(("path", "name"), CASES, ids=lambda value: getattr(value, "name", value))
def test_a_recorded_chunk_decodes_as_recorded(path: Path, name: str, native: bool) -> None:
    payloads, wanted = recorded(path, name)
    found = make.arrays_of(payloads, len(wanted["logits"]), native=native)
    assert found.keys() == wanted.keys()
    for key, array in wanted.items():
        assert found[key].dtype == array.dtype and found[key].shape == array.shape, key
        assert np.array_equal(found[key], array), key


@pytest.mark.parametrize("native", WAYS)
@pytest.mark.parametrize("name", sorted(make.cases()))
def test_the_newest_vectors_are_what_this_program_encodes(name: str, native: bool) -> None:
    assert list(make.encoded(make.cases()[name], native=native)) == recorded(FILES[-1], name)[0]
