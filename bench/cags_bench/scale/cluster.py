"""A queueing model of servers behind a balancer. A session costs its server the rendering of references.

The rules are those of the product. A session plans a frame per period. While its last job runs, later frames wait, and
only the newest is begun (:meth:`cags_server.session.streamer.Streamer.begin`). A server has as many renderers as
``cags-server --workers`` and runs jobs in order of arrival. The balancer sends a new session to the server with the
fewest (``least_conn`` of ``deploy/nginx/nginx.conf``), where it stays. If a server dies, its sessions join again after
the time that clients need to reconnect. Viewers stay for a random time; each one that leaves is replaced by another.
"""

from __future__ import annotations

import heapq
import random
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Load:
    """The viewers, and the cost of a reference."""

    sessions: int
    """Number of simultaneous sessions."""
    job_ms: float = 18.0
    """Time to render and code one reference on one renderer."""
    workers: int = 2
    """Renderers per server."""
    fps: float = 30.0
    lead_ms: float = 200.0
    """Time from planning a frame to its display; references that take longer are late."""
    stay_s: float = 20.0
    """Mean length of a session."""
    seconds: float = 30.0
    rejoin_ms: float = 500.0
    """Time from a server's death until its sessions have joined elsewhere."""
    seed: int = 1


@dataclass
class Outcome:
    """Result of a run."""

    due: int = 0
    """Number of planned references."""
    on_time: int = 0
    late: int = 0
    """References that came too late, or were skipped for a newer one. Those under way when the run, or their server,
    ends are neither late nor on time.
    """
    peak_imbalance: int = 0
    """Largest difference in sessions between the fullest and the emptiest living server."""

    @property
    def share(self) -> float:
        """Share of planned references that arrived in time."""
        return self.on_time / self.due if self.due else 1.0


@dataclass(eq=False)
class _Server:
    sessions: set[_Session] = field(default_factory=set)
    waiting: deque[tuple[_Session, float]] = field(default_factory=deque)
    idle: int = 0
    alive: bool = True


@dataclass(eq=False)
class _Session:
    ends_s: float
    server: _Server | None = None
    busy: bool = False
    overdue_s: float | None = None
    """Due time of the newest frame that waits for this session's renderer."""


class Cluster:
    """``servers`` of them under a :class:`Load`. Deterministic: the same load, the same outcome."""

    def __init__(self, servers: int, load: Load) -> None:
        self._load, self._random = load, random.Random(load.seed)  # noqa: S311 - arrivals of viewers
        self._servers = [_Server(idle=load.workers) for _ in range(servers)]
        self._events: list[tuple[float, int, Callable[[float], None]]] = []
        self._count = 0
        self.outcome = Outcome()

    def run(self, kill_at_s: float | None = None) -> Outcome:
        """Play the load; at ``kill_at_s`` the first server dies."""
        for _ in range(self._load.sessions):
            self._at(self._random.uniform(0, 1 / self._load.fps), self._arrive)
        if kill_at_s is not None:
            self._at(kill_at_s, self._kill)
        while self._events and self._events[0][0] <= self._load.seconds:
            now, _, event = heapq.heappop(self._events)
            event(now)
        return self.outcome

    def _at(self, time_s: float, event: Callable[[float], None]) -> None:
        self._count += 1
        heapq.heappush(self._events, (time_s, self._count, event))

    def _arrive(self, now: float) -> None:
        self._join(_Session(now + self._random.expovariate(1 / self._load.stay_s)), now)

    def _join(self, session: _Session, now: float) -> None:
        living = [server for server in self._servers if server.alive]
        if not living:
            return
        session.server = min(living, key=lambda server: len(server.sessions))
        session.server.sessions.add(session)
        counts = [len(server.sessions) for server in living]
        self.outcome.peak_imbalance = max(self.outcome.peak_imbalance, max(counts) - min(counts))
        self._frame(session, session.server, now)

    def _frame(self, session: _Session, server: _Server, now: float) -> None:
        """A frame of a session is due."""
        if session.server is not server:
            return
        if now >= session.ends_s:
            server.sessions.discard(session)
            self._arrive(now)
            return
        self.outcome.due += 1
        if session.busy:
            self.outcome.late += session.overdue_s is not None
            session.overdue_s = now
        else:
            self._ask(session, server, now, now)
        self._at(now + 1 / self._load.fps, lambda at: self._frame(session, server, at))

    def _ask(self, session: _Session, server: _Server, planned_s: float, now: float) -> None:
        session.busy, session.overdue_s = True, None
        server.waiting.append((session, planned_s))
        self._serve(server, now)

    def _serve(self, server: _Server, now: float) -> None:
        while server.idle and server.waiting:
            session, planned_s = server.waiting.popleft()
            server.idle -= 1
            done_s = now + self._load.job_ms / 1e3
            self._at(done_s, lambda at, s=session, p=planned_s: self._done(s, server, p, at))  # type: ignore[misc]

    def _done(self, session: _Session, server: _Server, planned_s: float, now: float) -> None:
        if not server.alive:
            return
        server.idle += 1
        if session.server is server:
            on_time = now - planned_s <= self._load.lead_ms / 1e3
            self.outcome.on_time += on_time
            self.outcome.late += not on_time
            session.busy = False
            if session.overdue_s is not None:
                self._ask(session, server, session.overdue_s, now)
        self._serve(server, now)

    def _kill(self, now: float) -> None:
        victim = self._servers[0]
        victim.alive = False
        for session in victim.sessions:
            session.server, session.busy, session.overdue_s = None, False, None
            self._at(now + self._load.rejoin_ms / 1e3, lambda at, s=session: self._join(s, at))  # type: ignore[misc]
        victim.sessions = set()
