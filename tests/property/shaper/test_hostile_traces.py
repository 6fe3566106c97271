"""Damaged traces of links and of heads give a trace or one line of TraceError, never more."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cags_common.errors import TraceError
from cags_common.poses.trace import COLUMNS, read_poses
from cags_shaper.trace import read_trace
from support.mutation import mutate

POSES = ",".join(COLUMNS) + "\n" + "".join(f"{i / 30:.6f},0.5,1.2,-3.25,0,0,0,1\n" for i in range(8))
READERS: dict[str, tuple[Callable[[Path], object], bytes]] = {
    "mahimahi": (read_trace, b"".join(b"%d\n" % (3 * i) for i in range(20))),
    "rates": (read_trace, b"time_s,mbps\n" + b"".join(b"%d.5,%d.25\n" % (i, 3 + i % 4) for i in range(12))),
    "poses": (read_poses, POSES.encode()),
}


def read_or_refuse(path: Path, read: Callable[[Path], object]) -> bool:
    try:
        read(path)
    except TraceError as error:
        assert "\n" not in str(error)
        assert str(error).startswith(str(path))
        return False
    return True


def fuzz(folder: Path, name: str, cases: int, seed: int) -> int:
    """Read ``cases`` damaged files; how many were still readable."""
    read, whole = READERS[name]
    path, taken = folder / f"{name}.txt", 0
    for case in range(cases):
        path.write_bytes(mutate(whole, np.random.default_rng((seed, case))))
        taken += read_or_refuse(path, read)
    return taken


@pytest.mark.parametrize("name", READERS)
def test_damaged_files(tmp_path: Path, name: str) -> None:
    assert 0 < fuzz(tmp_path, name, 1_000, seed=1) < 1_000


@pytest.mark.nightly
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("name", READERS)
def test_damaged_files_at_length(tmp_path: Path, name: str) -> None:
    fuzz(tmp_path, name, 100_000, seed=2)
