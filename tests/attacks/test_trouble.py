"""A real hour of eight viewers with random faults: nothing of it is left. See ``tests/trouble.py``."""

from pathlib import Path

import pytest

from trouble import hour


@pytest.mark.nightly
@pytest.mark.timeout(5400)
def test_an_hour_of_trouble_leaves_nothing_behind(tmp_path: Path) -> None:
    outcome = hour(tmp_path, minutes=60.0, seed=1)
    assert not outcome.faults(), outcome
    assert outcome.suffered.total() > 1000
