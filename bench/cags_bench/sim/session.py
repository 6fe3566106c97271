"""A client's whole session in virtual time: server core, links, client core, and a score for every frame."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cags_bench.sim.bundle import open_bundle, truth_of
from cags_bench.sim.seeds import trace_of, walk_of
from cags_bench.sim.spent import MeteredConnection, Spent
from cags_bench.sim.truth import LastTruth
from cags_bench.sim.usage import Usage
from cags_bench.sim.workers import Cores, SharedRenderer
from cags_bench.sim.world import Direction, World
from cags_client.frame.presented import PresentedFrame
from cags_client.output.report import frame_stats, summary
from cags_client.output.score import FlickerScore, score
from cags_client.playback.jobs import Decode, Present
from cags_client.playback.player import Player
from cags_client.settings import AUTO, OFF, ClientSettings
from cags_common import raster
from cags_common.bundle import BundleReader
from cags_common.errors import ConfigError
from cags_common.geometry import F32
from cags_common.poses import Focus
from cags_protocol.sessions.client import ClientSession
from cags_server.link import LinkState, MeasuredLink, OracleLink
from cags_server.reference.job import FrameRender
from cags_server.scene.library import SceneLibrary
from cags_server.settings import ServerSettings
from cags_shaper.link import Link, LinkSettings
from cags_shaper.trace import Trace, open_trace

if TYPE_CHECKING:
    from cags_common.lpips import Lpips

ESTIMATORS = ("oracle", "measured")

LPIPS_EVERY = 15
"""Interval of frames for LPIPS, which takes a hundred times as long as all other figures together."""

Watcher = Callable[[PresentedFrame, dict[str, Any]], None]


@dataclass(frozen=True)
class Cut:
    """The connection breaks at ``at_us``. Attempts to reconnect fail until ``until_us``."""

    at_us: int
    until_us: int


@dataclass(frozen=True)
class Scenario:
    """Complete description of a play; it determines the result."""

    bundle: Path
    trace: str
    poses: str
    server: ServerSettings = field(default_factory=ServerSettings)
    client: ClientSettings = field(default_factory=ClientSettings)
    estimator: str = "measured"
    delay_us: int = 20_000
    queue_bytes: int | None = None
    scored: bool = True
    score_every: int = 1
    """Every n-th frame is compared with the truth."""
    cuts: tuple[Cut, ...] = ()
    """Interruptions of the connection, in order."""
    draw_us: int = 0
    """Time that the client takes to draw a frame. If it is not 0, frames can be late and are dropped, as on a slow
    machine.
    """
    lpips: str = ""
    """Weights file of LPIPS. If given, LPIPS is computed for every :data:`LPIPS_EVERY`-th frame."""
    seed: int = 0
    """Selects the walk and the part of the trace (:mod:`cags_bench.sim.seeds`); 0: as named."""

    def __post_init__(self) -> None:
        if self.estimator not in ESTIMATORS:
            raise ConfigError(f"estimator = {self.estimator!r} must be one of {', '.join(ESTIMATORS)}")

    def link(self) -> Trace:
        """The trace, from the start given by the seed. Raises :class:`TraceError`."""
        return trace_of(open_trace(self.trace), self.seed)

    def truth(self) -> LastTruth:
        """Renderer of the true pictures. Raises :class:`BundleError`."""
        return LastTruth(open_bundle(self.bundle), self.client)


FIRST_SCORES = "psnr_restored_db", "lpips_restored"


@dataclass
class SessionResult:
    """Records of the presented frames, and a summary."""

    frames: list[dict[str, Any]]
    summary: dict[str, Any]
    spent: Spent = field(default_factory=Spent)
    """Times on this machine: the only part of a result that differs between runs."""


def simulate(scenario: Scenario, watch: Watcher | None = None, truth: LastTruth | None = None) -> SessionResult:
    """Play ``scenario`` to its end. ``watch`` is called with every presented frame and its record.

    ``truth`` renders the true pictures (:meth:`Scenario.truth`). Pass it if ``watch`` needs them too, so that each is
    drawn once. Deterministic: two runs give the same result. Raises :class:`CagsError` if a part fails.
    """
    with open_bundle(scenario.bundle) as reader:
        return _Simulation(scenario, scenario.link(), _library(scenario, reader), truth).run(watch)


def watched_by(watchers: Sequence[Watcher]) -> Watcher | None:
    """One watcher that calls all ``watchers``; None if there are none."""
    if not watchers:
        return None

    def watch(presented: PresentedFrame, record: dict[str, Any]) -> None:
        for watcher in watchers:
            watcher(presented, record)

    return watch


STEP_TOGETHER_US, STEP_ON_CORES_US = 10_000, 1_000
"""Longest difference between the clocks of sessions played together; shorter if they share cores."""


def simulate_together(
    scenarios: Sequence[Scenario], apart_us: int = 0, cores: int | None = None
) -> list[SessionResult]:
    """Play sessions of one bundle from one server, which shares its decoded and loaded data among them.

    Each session has its own clock and joins ``apart_us`` after the previous one. ``cores``: the server's work takes
    as long as on this many cores (:mod:`.workers`); None: it takes no time. Raises :class:`CagsError` if a part fails,
    :class:`ConfigError` if the bundles differ.
    """
    bundles = {str(scenario.bundle) for scenario in scenarios}
    if len(bundles) != 1:
        raise ConfigError(f"{len(bundles)} bundles: sessions played together need the same one")
    with open_bundle(Path(bundles.pop())) as reader:
        library = _library(scenarios[0], reader)
        shared = None if cores is None else Cores(cores)
        step_us = STEP_TOGETHER_US if cores is None else STEP_ON_CORES_US
        sessions = [
            _Simulation(scenario, scenario.link(), library, on=None if shared is None else (shared, number * apart_us))
            for number, scenario in enumerate(scenarios)
        ]
        now_us = 0
        while not all(session.player.finished for session in sessions):
            now_us += step_us
            for number, session in enumerate(sessions):
                session.play_until(now_us - number * apart_us)
        return [session.result() for session in sessions]


def _library(scenario: Scenario, reader: BundleReader) -> SceneLibrary:
    return SceneLibrary(reader, raster.create(scenario.server.rasteriser))


class _Simulation:
    def __init__(
        self,
        scenario: Scenario,
        trace: Trace,
        library: SceneLibrary,
        truth: LastTruth | None = None,
        on: tuple[Cores, int] | None = None,
    ) -> None:
        """``on``: the cores that run the server's work, and the delay of this session's clock against theirs."""
        self.scenario, self.trace, self.reader, self.library = scenario, trace, library.reader, library
        self.cuts = deque(scenario.cuts)
        self.unreachable_until_us = 0
        self.usage, self.spent = Usage(), Spent()
        self.renderer = None if on is None else SharedRenderer(*on, self.spent)
        self._rendering: tuple[int, FrameRender] | None = None  # (time of completion, outcome)
        self.dropped_bytes = 0  # by connections that were cut
        self.server = self._connection(0)
        self.player = Player(
            ClientSession(now_us=0), self._client_settings(), self._poses(), now_us=0, near=library.manifest.near
        )
        self._drawing: tuple[int, Present, PresentedFrame] | None = None  # (time of completion, action, frame)
        self.world = World(self.server, self.player, *self._directions(), self._work, alarm=self._alarm_us)
        self.truth = (truth or scenario.truth()) if scenario.scored else None
        self.frames: list[dict[str, Any]] = []
        self._first: dict[str, float] = {}  # scores of the first picture, if it was shown before playback
        self._flicker = FlickerScore()
        self._lpips = _lpips(scenario)
        self._watch: Watcher | None = None

    def run(self, watch: Watcher | None) -> SessionResult:
        """Play to the end of the clip."""
        self._watch = watch
        self.play_until(None)
        return self.result()

    def play_until(self, now_us: int | None) -> None:
        """Play to the end, or until ``now_us``."""
        clip_us = round(self.reader.manifest.frames * 1e6 / self.reader.manifest.fps)
        join_us = round(self.scenario.client.join_timeout * 1e6)
        limit_us = clip_us + join_us + 10_000_000
        self.world.run(
            lambda: self.player.finished or (now_us is not None and self.world.now_us >= now_us), limit_us=limit_us
        )
        if self.player.error is not None:
            raise self.player.error

    def result(self) -> SessionResult:
        """Result of a finished play."""
        return SessionResult(self.frames, self._summary(), self.spent)

    def _connection(self, now_us: int) -> MeteredConnection:
        link = make_link_state(self.scenario.estimator, self.trace)
        settings = self.scenario.server
        made = MeteredConnection(
            self.library,
            settings,
            name=f"simulated-{id(self)}",
            now_us=now_us,
            link=link,
            render_slots=self.renderer,
        )
        made.spent = self.spent
        self._rendering = None
        return made

    def _directions(self) -> tuple[Direction, Direction]:
        """Links to the client and back, empty."""
        delay_us = self.scenario.delay_us
        down = LinkSettings(delay_us=delay_us, queue_bytes=self.scenario.queue_bytes)
        return (
            Direction(Link(self.trace, down), self.player.receive),
            Direction(Link(None, LinkSettings(delay_us=delay_us)), self.server.receive),
        )

    def _alarm_us(self) -> int | None:
        """Time of the next cut, or when drawing or rendering ends."""
        times = [cut.at_us for cut in self.cuts] + [each[0] for each in (self._drawing, self._rendering) if each]
        return min(times, default=None)

    def _connections(self, now_us: int) -> bool:
        """Break the connection when it is due, and reconnect when the player asks for it."""
        busy = False
        if self.cuts and self.cuts[0].at_us <= now_us:
            self.unreachable_until_us = self.cuts.popleft().until_us
            self.server.connection_lost("cut", now_us)
            self.dropped_bytes += self.server.stats.bytes_dropped
            self.player.lost("cut", now_us)
            self.world.down, self.world.up = self._directions()
            busy = True
        if self.player.wants_connection(now_us):
            if now_us < self.unreachable_until_us:
                self.player.lost("unreachable", now_us)
            else:
                self.server = self.world.server = self._connection(now_us)
                self.world.down, self.world.up = self._directions()
                self.player.connected(now_us)
            busy = True
        return busy

    def _client_settings(self) -> ClientSettings:
        """Nothing is late in virtual time unless drawing takes time, and no display needs frames in between."""
        between = OFF if self.scenario.client.interpolate == AUTO else self.scenario.client.interpolate
        return replace(self.scenario.client, drop_late=self.scenario.draw_us > 0, interpolate=between)

    def _poses(self) -> Any:
        manifest = self.reader.manifest
        focus = Focus(manifest.focus_centre, manifest.focus_radius, manifest.up)
        clip_s = manifest.frames / manifest.fps
        if self.scenario.client.duration is not None:
            clip_s = min(clip_s, self.scenario.client.duration)
        window_us = self.scenario.client.start_delay_ms * 1000 + round(clip_s * 1e6)
        return walk_of(self.scenario.poses, focus, window_us, self.scenario.seed)

    def _work(self, now_us: int) -> bool:
        busy = self._connections(now_us)
        if self._rendering is not None and self._rendering[0] <= now_us:
            (_, render), self._rendering = self._rendering, None
            self.server.job_done(render, now_us)
            busy = True
        while (job := self.server.next_job(now_us)) is not None:
            busy = True
            if self.renderer is not None:
                self._rendering = self.renderer.run(job, now_us)
                break
            self.server.job_done(self.spent.job(job, now_us), now_us)
        busy |= self._drawn(now_us)
        while (action := self.player.next_action(now_us)) is not None:
            busy = True
            if isinstance(action, Decode):
                self.usage.arrived(action.events)
                self.player.done(action, self.spent.decoding(action.run), now_us)
            else:
                self._present(action, now_us)
        return busy

    def _present(self, action: Present, now_us: int) -> None:
        """Draw a frame. It is restored only if it is scored or watched."""
        scored = self._scores(action.frame) or self._watch is not None
        self.player.live.restore = self.scenario.client.restore if scored else "none"
        self._drawing = now_us + self.scenario.draw_us, action, self.spent.presenting(action.run)
        self._drawn(now_us)

    def _drawn(self, now_us: int) -> bool:
        """Show the frame whose drawing is complete; False if there is none."""
        if self._drawing is None or self._drawing[0] > now_us:
            return False
        (_, action, result), self._drawing = self._drawing, None
        if action.media:
            self.spent.begins_play(now_us)
            self._record(action, result, now_us)
        elif action.first and self.truth is not None and not self._first:
            self._first = self._scored(result, *self.truth(result.frame, result.camera))
        self.player.done(action, result, now_us)
        return True

    def _scores(self, frame: int) -> bool:
        return frame % self.scenario.score_every == 0

    def _record(self, action: Present, presented: PresentedFrame, now_us: int) -> None:
        record = frame_stats(presented, action, now_us)
        record = {key: value for key, value in record.items() if not key.startswith("ms_")}
        if self.scenario.scored:
            self.usage.shown(presented, action.pipeline)
        record["drawn_share"] = float(presented.alpha.mean())
        if self.truth is not None and self._scores(presented.frame):
            record |= self._scored(presented, *self.truth(presented.frame, presented.camera))
        self.frames.append(record)
        if self._watch is not None:
            self._watch(presented, record)

    def _scored(self, presented: PresentedFrame, truth: F32, alpha: F32) -> dict[str, float]:
        out = score(presented, truth, alpha) | self._flicker(presented, truth)
        if self._lpips is not None and presented.frame % LPIPS_EVERY == 0:
            out["lpips_restored"] = self._lpips.distance(presented.rgb.clip(0, 1), truth.clip(0, 1))
        return out

    def _summary(self) -> dict[str, Any]:
        out = summary(self.frames, self.player.stats)
        if self.scenario.scored:
            dropped_bytes = self.dropped_bytes + self.server.stats.bytes_dropped
            out["wasted_bytes"] = self.usage.wasted_bytes(dropped_bytes)
            out["wasted_share"] = out["wasted_bytes"] / max(self.usage.arrived_bytes + dropped_bytes, 1)
            out["truth"] = truth_of(self.scenario.bundle)
        out["fps"] = self.reader.manifest.fps
        out["first_picture_ms"] = (self.player.stats.first_picture_us or 0) / 1e3
        out |= {f"first_{name}": self._first[name] for name in FIRST_SCORES if name in self._first}
        out["link_effects"] = sorted(self.world.down.link.effects)
        out["capacity_mbps"] = self.trace.mean_bps(0, max(self.world.now_us, 1)) / 1e6
        return out


def _lpips(scenario: Scenario) -> Lpips | None:
    if not (scenario.lpips and scenario.scored):
        return None
    from cags_common.lpips import Lpips

    return Lpips(scenario.lpips)


def make_link_state(name: str, trace: Trace) -> LinkState:
    """``oracle`` knows the trace, as in the paper; ``measured`` estimates from acknowledgements."""
    return OracleLink(trace) if name == "oracle" else MeasuredLink()
