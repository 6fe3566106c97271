"""A tile's versions: what is to be staged of them."""

from __future__ import annotations

from cags_common.store.versions import Versions


class Levels:
    """A decoder that counts."""

    lod = 0

    def fork(self) -> Levels:
        """Another one."""
        return Levels()


def test_what_is_to_be_staged_again_still_is_when_something_comes_that_changes_nothing() -> None:
    versions = Versions(Levels(), 0)
    for version in versions.fresh():
        version.handed_out()
    versions.writable(0)
    assert versions.fresh() == []  # nothing is staged for a level that changed nothing
    versions.touch()
    for version in versions.fresh():
        version.handed_out()
    versions.again()
    versions.writable(0)
    assert [version.state for version in versions.fresh()] == [versions.newest]
