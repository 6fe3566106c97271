"""Versions of one decoded tile by mark: the state up to a mark never changes by what arrives after it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar


class Forking(Protocol):
    """A decoder that can be copied before data is added to it."""

    @property
    def lod(self) -> int:
        """Highest LoD up to which all levels have arrived."""
        ...

    def fork(self: S) -> S:
        """A copy of the decoder with its data."""
        ...


S = TypeVar("S", bound=Forking)


@dataclass(eq=False)
class Version(Generic[S]):
    """The state of a tile after the last data before the next mark."""

    since: int
    """The last mark before it; the state is valid for all later marks."""
    state: S
    fresh: bool = True
    """Whether it has data to be staged."""
    staged: bool = False
    """Whether it was handed out, after which nothing may be added."""

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
        """Everything received."""
        return self._all[-1].state

    def __len__(self) -> int:
        return len(self._all)

    def writable(self, since: int) -> S:
        """The state to which data after mark ``since`` is added. Call :meth:`touch` if that changed anything."""
        last = self._all[-1]
        if last.since == since:
            if last.staged:  # a request of :meth:`again` must still be staged, even if nothing new is added
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
        """No mark before ``basis`` is requested any more: keep only the newest of the versions before it."""
        before = sum(version.since < basis for version in list(self._all))
        if before > 1:
            del self._all[: before - 1]
