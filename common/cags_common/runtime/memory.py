"""Memory that this process may take."""

from __future__ import annotations

import os
from pathlib import Path

CGROUP = Path("/sys/fs/cgroup/memory.max")
"""The limit of a container, bytes, or "max"; Linux."""


def memory_mb() -> float | None:
    """Memory of the machine, or of the container, MB; None where the system does not tell."""
    try:
        machine = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1e6
    except (AttributeError, OSError, ValueError):  # no such call on Windows
        return None
    try:
        return min(machine, int(CGROUP.read_text()) / 1e6)
    except (OSError, ValueError):
        return machine
