"""What is decoded of one tile, mark by mark: what is shown up to a mark never changes by what comes after it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar


class Forking(Protocol):
    """A decoder that can be copied before something is added to it."""

    @property
    def lod(self) -> int:
        """Highest LoD up to which everything has come."""
        ...

    def fork(self: S) -> S:
        """Another decoder of what has come."""
        ...


S = TypeVar("S", bound=Forking)


@dataclass(eq=False)
class Version(Generic[S]):
    """A tile as it was after the last thing that came of it before the next mark."""

    since: int
    """The last mark that came before it; it counts for every later one."""
    state: S
    fresh: bool = True
    """Whether it holds something that is to be staged."""
    staged: bool = False
    """Whether what it holds was handed out: it is not added to any more."""

    def handed_out(self) -> S:
        """The state, to be staged."""
        self.fresh, self.staged = False, True
        return self.state


class Versions(Generic[S]):
    """The versions of one tile, the newest last. One thread may add while another trims."""

    def __init__(self, state: S, since: int) -> None:
        self._all = [Version(since, state)]

    @property
    def newest(self) -> S:
        """All that has come."""
        return self._all[-1].state

    def __len__(self) -> int:
        return len(self._all)

    def writable(self, since: int) -> S:
        """The state to add to what comes after mark ``since``; :meth:`touch` where that changed anything."""
        last = self._all[-1]
        if last.since == since:
            if last.staged:  # what :meth:`again` asked for is still to be staged, though nothing new should be added
                self._all[-1] = Version(since, last.state.fork(), fresh=last.fresh)
        else:
            self._all.append(Version(since, last.state.fork(), fresh=False))
        return self._all[-1].state

    def touch(self) -> None:
        """The newest has changed."""
        self._all[-1].fresh = True

    def fresh(self) -> list[Version[S]]:
        """Versions that are to be staged."""
        return [version for version in list(self._all) if version.fresh]

    def again(self) -> None:
        """All are to be staged again."""
        for version in self._all:
            version.fresh = True

    def trim(self, basis: float) -> None:
        """Nothing before mark ``basis`` is asked for any more: of what came before it only the newest stays."""
        before = sum(version.since < basis for version in list(self._all))
        if before > 1:
            del self._all[: before - 1]
