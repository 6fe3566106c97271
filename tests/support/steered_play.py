"""A viewer who pauses, seeks, loops and loses the connection, in virtual time, and what must hold afterwards."""

from __future__ import annotations

import random
from collections import deque
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from cags_bench.sim.session import Scenario, _library, _Simulation, open_bundle
from cags_bench.sim.spent import MeteredConnection, Spent
from cags_bench.sim.world import World
from cags_client.playback.interactive import InteractivePlayer
from cags_client.settings import ClientSettings
from cags_protocol.sessions.client import ClientSession
from cags_server.reference.job import FrameJob, FrameRender
from cags_server.settings import ServerSettings

CLIENT = ClientSettings(width=96, height=72, reconnect_s=30)
SERVER = ServerSettings(reference_width=64, reference_height=48)

Key = tuple[int, int]
Wish = tuple[int, Callable[[InteractivePlayer, int], object]]
"""A time in microseconds, and what the viewer does with the player then."""


class SteeredPlay(_Simulation):
    """One play, steered by ``wishes``; jobs of the server take up to ``jobs_us``, as ``rng`` draws."""

    def __init__(
        self, scenario: Scenario, wishes: Iterable[Wish] = (), *, jobs_us: int = 0, rng: random.Random | None = None
    ) -> None:
        library = _library(scenario, open_bundle(scenario.bundle))
        super().__init__(scenario, scenario.link(), library)
        session, settings = ClientSession(now_us=0), self._client_settings()
        self.player: InteractivePlayer = InteractivePlayer(
            session, settings, self._poses(), now_us=0, near=library.manifest.near
        )
        self.world = World(self.server, self.player, *self._directions(), self._work, alarm=self._alarm_us)
        self._wishes = deque(sorted(wishes, key=lambda wish: wish[0]))
        if jobs_us:
            self.renderer: Any = SlowRenderer(self.spent, jobs_us, rng or random.Random(0))

    def until(self, seconds: float) -> None:
        """Play until this time. Raises what ended the play."""
        end_us = round(seconds * 1e6)
        self.world.run(lambda: self.player.finished or self.world.now_us >= end_us, limit_us=10**15)
        if self.player.error is not None:
            raise self.player.error

    def problems(self) -> list[str]:
        """What is wrong with a play that has been paused for some seconds."""
        player, manifest = self.player, self.library.manifest
        pipeline = player.pipeline
        assert pipeline is not None
        errors = player.stats.decode_errors
        out = [f"payloads that did not decode: {errors}"] if errors else []
        if player.finished or player.away:
            out.append("the play has ended, or is away")
        held = {(tile.frame, tile.tile): tile.lods for tile in pipeline.held()}
        group = manifest.gof_frames(manifest.gof_of(player.frame))
        for key, levels in self.believed().items():
            if key[0] in group and key[0] <= player.frame and held.get(key, 0) < levels:
                out.append(f"the server believes in {levels} levels of tile {key}, the client has {held.get(key, 0)}")
        shown = pipeline.on_display
        if shown is None or shown.shown_frame != player.frame or not shown.whole:
            out.append(f"frame {player.frame} is not on display, or not whole")
        if player._awaited is not None or player._restarts_due:
            out.append(f"frame {player.frame} is still waited for")
        if pipeline._committed_mark < pipeline._marked - 2:
            out.append(f"mark {pipeline._committed_mark} of {pipeline._marked} is shown")
        return out

    def believed(self) -> dict[Key, int]:
        """The levels of each tile of which the server has heard that they arrived, from the lowest on."""
        inventory = self.server.streamer._tiles.inventory
        masks = {key: held.delivered for key, held in inventory._tiles.items()}
        return {key: (~mask & (mask + 1)).bit_length() - 1 for key, mask in masks.items()}

    def _alarm_us(self) -> int | None:
        times = [super()._alarm_us(), self._wishes[0][0] if self._wishes else None]
        return min((t for t in times if t is not None), default=None)

    def _work(self, now_us: int) -> bool:
        wished = bool(self._wishes) and self._wishes[0][0] <= now_us
        while self._wishes and self._wishes[0][0] <= now_us:
            self._wishes.popleft()[1](self.player, now_us)
        return super()._work(now_us) or wished

    def _connection(self, now_us: int) -> MeteredConnection:
        renderer, self.renderer = self.renderer, None  # it has a place for every job
        made = super()._connection(now_us)
        self.renderer = renderer
        return made


class SlowRenderer:
    """Jobs that take up to ``most_us``, as ``rng`` draws."""

    def __init__(self, spent: Spent, most_us: int, rng: random.Random) -> None:
        self._spent, self._most_us, self._rng = spent, most_us, rng

    def run(self, job: FrameJob, now_us: int) -> tuple[int, FrameRender]:
        """When the job is done, and its result."""
        return now_us + self._rng.randint(1, self._most_us), self._spent.job(job, now_us)


def scenario_of(bundle: Path, trace: str = "generated:steady-8", **more: Any) -> Scenario:
    """A viewer who walks, whose pictures nobody scores."""
    given = {"server": SERVER, "client": CLIENT, "scored": False} | more
    return Scenario(bundle, trace, "synthetic:walking", **given)
