"""The clip that is served under attack."""

import fcntl
from pathlib import Path

import pytest

from support.siege import encode_small


@pytest.fixture(scope="session")
def bundle(tmp_path_factory: pytest.TempPathFactory, worker_id: str) -> Path:
    """Encoded once, by the first of the processes that run tests beside each other."""
    base = tmp_path_factory.getbasetemp()
    folder = (base if worker_id == "master" else base.parent) / "clip"
    folder.mkdir(exist_ok=True)
    with (folder / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        return folder / "clip.cags" if (folder / "clip.cags").is_dir() else encode_small(folder)
