"""Runs the units of a reproduction ahead, on all cores; each is kept when done.

A unit starts when its encodings are there, and an encoding when its clip is linked. Long ones come first, so no core
waits for the last.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from dataclasses import dataclass, field
from typing import Any

from cags_bench.reproduce.cases import Clip, Encoding, Runner, StreamCase, Work
from cags_bench.reproduce.methods import METHODS
from cags_common.runtime.processes import process_pool

NETWORKS = {"srresnet", "sr-align-ref", "cr-no-ref"}

CODECS = ("video", "density", "svq")
"""Codecs, the slowest to encode first."""

Tell = Callable[[str], None]


def prepare(runner: Runner, works: Iterable[Work], workers: int, tell: Tell) -> None:
    """Compute every unit that is not there yet. An interrupted run loses only the units that were being computed."""
    missing = sorted((work for work in dict.fromkeys(works) if not runner.done(work)), key=_quick)
    if workers < 2 or len(missing) < 2:
        return  # the experiments run them one by one
    one_thread = Runner(runner.results, runner.bundles, runner.device, threads=1, progress=False)
    with process_pool(workers) as pool:
        _Ahead(one_thread, pool, missing, tell).run()


def _quick(work: Work) -> bool:
    """Sorts what takes longest to the front, so that no core is idle at the end: sessions that run a network."""
    return not (isinstance(work, StreamCase) and METHODS[work.method].client.get("restore") in NETWORKS)


def _short(encoding: Encoding) -> tuple[bool, int]:
    """Sorts long encodings to the front: clips before single frames, slow codecs before others."""
    return encoding.settings.frames == 1, CODECS.index(encoding.settings.codec)


@dataclass
class _Ahead:
    """Clips whose splats are linked, encodings and units under way, each started when what it needs is there."""

    runner: Runner
    pool: ProcessPoolExecutor
    works: Sequence[Work]
    tell: Tell
    under_way: dict[Future[object], Clip | Encoding | Work] = field(default_factory=dict)
    done: set[Clip | Encoding] = field(default_factory=set)
    counts: Counter[str] = field(default_factory=Counter)

    def run(self) -> None:
        """Return when all is done; what fails ends the rest."""
        encodings = sorted(dict.fromkeys(one for work in self.works for one in work.encodings), key=_short)
        clips = list(dict.fromkeys(one.clip for one in encodings))
        self._submit(self.runner.link, clips)
        waiting: list[Encoding | Work] = [*encodings, *self.works]
        totals = {"encoded": len(encodings), "computed": len(self.works)}
        try:
            while self.under_way:
                for future in wait(self.under_way, return_when=FIRST_COMPLETED).done:
                    future.result()
                    self._told(self.under_way.pop(future), totals)
                waiting = self._start(waiting)
        except BaseException:
            for future in self.under_way:
                future.cancel()
            raise

    def _told(self, one: Clip | Encoding | Work, totals: Mapping[str, int]) -> None:
        if isinstance(one, tuple):
            self.done.add(one)
            return
        stage, what = ("encoded", _differing(one)) if isinstance(one, Encoding) else ("computed", str(one))
        if isinstance(one, Encoding):
            self.done.add(one)
        self.counts[stage] += 1
        self.tell(f"{stage} {self.counts[stage]}/{totals[stage]}: {what}")

    def _start(self, waiting: Sequence[Encoding | Work]) -> list[Encoding | Work]:
        """Start what can be, and return the rest."""
        rest = []
        for one in waiting:
            needs = [one.clip] if isinstance(one, Encoding) else one.encodings
            if not self.done.issuperset(needs):
                rest.append(one)
            elif isinstance(one, Encoding):
                self._submit(self.runner.bundle, [one])
            else:
                self._submit(self.runner.run, [one])
        return rest

    def _submit(self, work: Callable[[Any], object], ones: Sequence[Clip | Encoding | Work]) -> None:
        self.under_way |= {self.pool.submit(work, one): one for one in ones}


def _differing(encoding: Encoding) -> str:
    """What sets an encoding apart."""
    settings = encoding.settings
    return f"{encoding.scene}, {settings.codec} {settings.quantiser}, {settings.frames} frames"
