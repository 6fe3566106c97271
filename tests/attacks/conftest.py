"""The clip that is served under attack."""

from pathlib import Path

import pytest

from support.siege import encode_small


@pytest.fixture(scope="session")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return encode_small(tmp_path_factory.mktemp("clip"))
