"""How much memory a process finds."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from cags_common.runtime import memory
from cags_common.runtime.memory import memory_mb


@pytest.fixture(autouse=True)
def machine(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """A machine of 8 GB, and the file that limits a container in it."""
    pages = {"SC_PAGE_SIZE": 4_000, "SC_PHYS_PAGES": 2_000_000}
    monkeypatch.setattr(os, "sysconf", pages.__getitem__, raising=False)
    monkeypatch.setattr(memory, "CGROUP", tmp_path / "memory.max")
    return tmp_path / "memory.max"


def test_it_is_that_of_the_machine() -> None:
    assert memory_mb() == 8_000


@pytest.mark.parametrize(
    ("limit", "found"), [("1500000000\n", 1_500), ("max\n", 8_000), ("99000000000\n", 8_000), ("", 8_000)]
)
def test_a_container_may_have_less(limit: str, found: float, machine: Path) -> None:
    machine.write_text(limit)
    assert memory_mb() == found


@pytest.mark.parametrize("trouble", [ValueError, OSError, AttributeError])
def test_a_system_may_not_tell(trouble: type[Exception], monkeypatch: pytest.MonkeyPatch) -> None:
    def sysconf(_: str) -> int:
        raise trouble

    monkeypatch.setattr(os, "sysconf", sysconf, raising=False)
    assert memory_mb() is None
