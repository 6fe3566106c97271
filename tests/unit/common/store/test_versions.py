"""A tile's versions: what is to be staged of them."""

from __future__ import annotations

import pytest

from cags_common.store.versions import Versions


class Levels:
    """A decoder that counts."""

    lod = 0

    def fork(self) -> Levels:
        """Another one."""
        return Levels()


@pytest.mark.parametrize("later", [0, 1])
def test_what_is_to_be_staged_again_still_is_when_something_comes_that_changes_nothing(later: int) -> None:
    versions = Versions(Levels(), 0)
    for version in versions.fresh():
        version.handed_out()
    versions.writable(later)
    assert versions.fresh() == []
    versions.again()
    versions.writable(later)
    assert versions.fresh()[-1].state is versions.newest
