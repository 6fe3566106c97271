"""What all tests share: hypothesis without deadlines, and which tests ``pytest -m quick`` runs."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import settings

# An example's time says how busy the machine is: `pytest --timeout` alone ends what hangs.
settings.register_profile("default", deadline=None)
settings.load_profile("default")

UNIT = Path(__file__).parent / "unit"
QUICK = [
    UNIT / "protocol",
    *(UNIT / "kernels" / f"test_{name}.py" for name in ("library", "motion", "wrong_shapes")),
    *(UNIT / "common" / name for name in ("tiles", "coding", "store", "test_geometry.py", "test_settings.py")),
    *(UNIT / "client" / name for name in ("playback", "net", "store")),
    *(UNIT / "server" / "session" / f"test_{name}.py" for name in ("schedule", "parts", "startup")),
]
"""The core without renders, encoders, processes or networks: under 30 s of one processor, everything included."""

NOT_QUICK = {"slow", "nightly", "gpu", "siege", "faults"}


def is_quick(path: Path) -> bool:
    """Whether the tests of ``path`` are quick."""
    return any(path == one or one in path.parents for one in QUICK)


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """With ``-m quick`` nothing else is even imported: that alone takes as long as the tests."""
    if config.option.markexpr != "quick" or is_quick(collection_path):
        return None
    leads_there = any(collection_path in one.parents for one in QUICK)
    return None if leads_there else True


@pytest.fixture
def groups_pass(monkeypatch: pytest.MonkeyPatch) -> None:
    """No clip of several groups of frames is kept whole: decoders drop the groups that are past."""
    monkeypatch.setattr("cags_common.bundle.manifest.MAX_WHOLE_SPLATS", 0)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark what is quick."""
    for item in items:
        if is_quick(item.path) and not NOT_QUICK & {mark.name for mark in item.iter_markers()}:
            item.add_marker(pytest.mark.quick)
