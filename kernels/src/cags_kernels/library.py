"""Loads the native library once, and keeps the reason when it cannot."""

from __future__ import annotations

import ctypes
import os
from functools import cache
from pathlib import Path

ABI_VERSION = 12
_LIBRARY = "libcags_kernels.so"
_REASONS = {1: "an argument is out of range", 2: "out of memory", 3: "an internal failure"}


class KernelError(RuntimeError):
    """A native call failed: the reason, and the call's name."""


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
