"""Loads the native library once, and keeps the reason when it cannot."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

from numpy.typing import NDArray

ABI_VERSION = 19
_LIBRARY = "libcags_kernels.so"
_REASONS = {1: "an argument is out of range", 2: "out of memory", 3: "an internal failure"}


class KernelError(RuntimeError):
    """A native call failed: the reason, and the call's name."""


class _Field(ctypes.Structure):
    _fields_ = [
        ("structure", ctypes.c_char_p),
        ("field", ctypes.c_char_p),
        ("offset", ctypes.c_int64),
        ("bytes", ctypes.c_int64),
    ]


Structure = TypeVar("Structure", bound=type[ctypes.Structure])


def native(name: str) -> Callable[[Structure], Structure]:
    """The decorated class is structure ``name`` of the interface: its size and offsets are compared when it is made.

    Raises :class:`KernelError` where the loaded library has another; without a library there is nothing to compare.
    """

    def register(structure: Structure) -> Structure:
        loaded = _load()[0]
        wrong = None if loaded is None else difference(structure, _layout(loaded).get(name, {}))
        if wrong:
            raise KernelError(f"structure {name} is another than the library's: {wrong}; reinstall cags-kernels")
        return structure

    return register


def difference(structure: type[ctypes.Structure], native_layout: dict[str, tuple[int, int]]) -> str:
    """The first difference from ``native_layout`` (field -> offset and bytes; ``""``: the whole); empty: none."""
    ours = {"": (0, ctypes.sizeof(structure))}
    for field, *_ in structure._fields_:
        place = getattr(structure, field)
        ours[field] = (place.offset, place.size)
    for field in [*ours, *native_layout]:
        here, there = ours.get(field), native_layout.get(field)
        if here != there:
            return f"{field or 'the whole'} at {here} here and {there} there (offset, bytes)"
    return ""


def _layout(loaded: ctypes.CDLL) -> dict[str, dict[str, tuple[int, int]]]:
    """Structure -> field -> offset and bytes, as the library was compiled."""
    loaded.cags_layout.restype = ctypes.POINTER(_Field)
    count = ctypes.c_int64()
    fields = loaded.cags_layout(ctypes.byref(count))
    layout: dict[str, dict[str, tuple[int, int]]] = {}
    for field in fields[: count.value]:
        layout.setdefault(field.structure.decode(), {})[field.field.decode()] = field.offset, field.bytes
    return layout


@cache
def _load() -> tuple[ctypes.CDLL | None, str]:
    path = Path(os.environ.get("CAGS_KERNELS_LIBRARY") or Path(__file__).with_name(_LIBRARY))
    if not path.exists():
        return (
            None,
            f"cags-kernels was installed without its native library ({path.name}): no C++20 compiler was found then",
        )
    try:
        loaded = ctypes.CDLL(str(path))
        version = int(loaded.cags_abi_version())
    except (OSError, AttributeError) as error:
        return None, f"{path} cannot be loaded: {error}"
    if version != ABI_VERSION:
        return None, f"{path} has interface version {version}, this package needs {ABI_VERSION}; reinstall cags-kernels"
    loaded.cags_instruction_set.restype = ctypes.c_char_p
    loaded.cags_multiply_adds.restype = ctypes.c_double
    loaded.cags_multiply_adds.argtypes = [ctypes.c_int64]
    return loaded, ""


def native_available() -> bool:
    """Whether the native library is there and loads."""
    return _load()[0] is not None


def why_unavailable() -> str:
    """Why :func:`native_available` is false; empty when it is true."""
    return _load()[1]


def library() -> ctypes.CDLL:
    """The loaded library. Raises :class:`KernelError` with the reason when there is none."""
    loaded, reason = _load()
    if loaded is None:
        raise KernelError(reason)
    return loaded


def check(status: int, call: str) -> None:
    """Raise :class:`KernelError` unless ``status`` is that of success."""
    if status != 0:
        raise KernelError(f"{call}: {_REASONS.get(status, f'status {status}')}")


def address(array: NDArray[Any] | None) -> ctypes.c_void_p:
    """Of the first element; null where there is no array."""
    return ctypes.c_void_p(None if array is None else array.ctypes.data)


def fields(*arrays: NDArray[Any] | None) -> tuple[Any, ...]:
    """Fields of a structure: the address of each array, null where there is none, and a row of all their elements."""
    addresses = [None if array is None else array.ctypes.data for array in arrays]
    return (*addresses, tuple([0 if array is None else array.size for array in arrays]))


def sized(array: NDArray[Any]) -> tuple[ctypes.c_void_p, ctypes.c_int64]:
    """An array as an argument and the next: its address and its elements."""
    return address(array), ctypes.c_int64(array.size)


def instruction_set() -> str:
    """Name of the variant that runs: ``avx512``, ``avx2`` or ``portable``."""
    name: bytes = library().cags_instruction_set()
    return name.decode()


def use_instruction_set(name: str) -> None:
    """Run another variant from now on (tests, benchmarks). Raises :class:`KernelError` if this processor cannot."""
    check(library().cags_use_instruction_set(name.encode()), f"use_instruction_set({name!r})")


def multiply_adds(rounds: int) -> float:
    """Do ``rounds`` rounds of independent vector multiply-adds; how many they were, lane by lane (benchmarks)."""
    return float(library().cags_multiply_adds(rounds))
