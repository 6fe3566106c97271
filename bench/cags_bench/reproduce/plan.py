"""How large a reproduction is: scenes, frames, sizes; quick, or whole."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from cags_bench.jsonl import JsonObject
from cags_bench.reproduce import added
from cags_bench.reproduce.cases import Runner, StreamCase, Work
from cags_bench.reproduce.methods import ABLATIONS, BASELINES, GENERAL, GENERAL_WHOLE, RANGE
from cags_bench.reproduce.section import Section

PAPER_RATES_MBPS = (30.0, 60.0, 90.0, 120.0, 150.0)
QUICK_RATES_MBPS = (30.0, 60.0, 150.0)


@dataclass(frozen=True)
class Plan:
    """What every experiment works on."""

    scenes: tuple[str, ...]
    poses: str
    trace: str
    frames: int
    width: int
    height: int
    quick: bool
    lpips: str = ""
    video: tuple[str, ...] = ()
    """Metrics of whole films (:data:`cags_bench.film.metrics.METRICS`) that are measured."""
    chosen: tuple[str, ...] = ()
    """Methods that are compared; none: all."""
    over: tuple[float | None, ...] = ()
    """Links that methods are compared over; none: the rates of the size, and the trace."""
    walks: str = ""
    """Folder of recorded walks of people; empty: none."""
    kept: bool = False
    """Only sessions that earlier runs have finished."""

    @property
    def rates_mbps(self) -> tuple[float, ...]:
        """Fixed bandwidths, the paper's."""
        if self.over:
            return tuple(mbps for mbps in self.over if mbps is not None)
        return QUICK_RATES_MBPS if self.quick else PAPER_RATES_MBPS

    @property
    def links(self) -> tuple[float | None, ...]:
        """The fixed bandwidths, and None for the trace."""
        return self.over or (*self.rates_mbps, None)

    @property
    def methods(self) -> tuple[str, ...]:
        """Ours, ours with each part that was added, as published, and every baseline."""
        every = ("cags", *added.names(), "cags-paper", *BASELINES)
        return tuple(name for name in every if not self.chosen or name in (*self.chosen, "cags"))

    @property
    def in_range(self) -> tuple[str, ...]:
        """Methods over the trace as recorded."""
        return tuple(name for name in RANGE if name in self.methods)

    @property
    def general(self) -> tuple[str, ...]:
        """Methods on other representations."""
        return GENERAL if self.quick else (*GENERAL, *GENERAL_WHOLE)

    @property
    def ablations(self) -> tuple[str, ...]:
        """Ours and the published way, and each without one part."""
        return ("cags", "cags-paper", "cr-no-ref", *ABLATIONS)


@dataclass(frozen=True)
class Context:
    """A plan and what runs it."""

    plan: Plan
    runner: Runner
    tell: Callable[[str], None]

    def there(self, case: StreamCase) -> bool:
        """Whether the result of ``case`` may be asked for."""
        return not self.plan.kept or self.runner.done(case)

    def result(self, work: Work) -> JsonObject:
        """The result of ``work``."""
        if not self.runner.done(work):
            self.tell(str(work))
        return self.runner.run(work)

    def case(self, scene: str, method: str, mbps: float | None = None, *, unscaled: bool = False) -> StreamCase:
        """One streamed case of the plan. LPIPS and films are measured only where a table shows them; in a quick run
        films, which take a quarter of a session's time, over the slowest link and the trace.
        """
        p = self.plan
        case = StreamCase(scene, method, p.poses, p.frames, p.width, p.height, p.trace, mbps, unscaled)
        shown = scene in p.scenes and method in p.methods and mbps in p.links and not unscaled
        filmed = shown and (not p.quick or mbps in (p.rates_mbps[0], None))
        return replace(case, lpips=p.lpips if shown else "", video=p.video if filmed else ())


@dataclass(frozen=True)
class Experiment:
    """A table or figure that can be made again by name."""

    name: str
    kind: str
    """``table`` or ``figure``."""
    title: str
    run: Callable[[Context], Section]
    cases: Callable[[Context], Sequence[Work]] = lambda _: ()
    """The units of work that it will ask for: they are run ahead, side by side."""
