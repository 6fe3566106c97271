"""Runs the units of a reproduction ahead, on all cores; each is kept when done.

A unit starts when its encodings are there. Encodings come first, the long ones ahead, so no core waits for the last.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from dataclasses import dataclass, field

from cags_bench.reproduce.cases import Encoding, Runner, StreamCase, Work
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
    """Encodings and units under way."""

    runner: Runner
    pool: ProcessPoolExecutor
    works: Sequence[Work]
    tell: Tell
    encoding: dict[Future[object], Encoding] = field(default_factory=dict)
    computing: dict[Future[object], Work] = field(default_factory=dict)
    encoded: set[Encoding] = field(default_factory=set)

    def run(self) -> None:
        """Return when all is done; what fails ends the rest."""
        wanted = sorted(dict.fromkeys(one for work in self.works for one in work.encodings), key=_short)
        self.encoding = {self.pool.submit(self.runner.bundle, one): one for one in wanted}
        waiting = self._start(self.works)
        done_encodings = done_works = 0
        try:
            while self.encoding or self.computing:
                for future in wait([*self.encoding, *self.computing], return_when=FIRST_COMPLETED).done:
                    future.result()
                    if future in self.encoding:
                        one = self.encoding.pop(future)
                        self.encoded.add(one)
                        waiting = self._start(waiting)
                        done_encodings += 1
                        self.tell(f"encoded {done_encodings}/{len(wanted)}: {one.scene}, {_differing(one)}")
                    else:
                        done_works += 1
                        self.tell(f"computed {done_works}/{len(self.works)}: {self.computing.pop(future)}")
        except BaseException:
            for future in (*self.encoding, *self.computing):
                future.cancel()
            raise

    def _start(self, works: Sequence[Work]) -> list[Work]:
        """Start the units whose encodings are there, and return the others."""
        waiting = []
        for work in works:
            if self.encoded.issuperset(work.encodings):
                self.computing[self.pool.submit(self.runner.run, work)] = work
            else:
                waiting.append(work)
        return waiting


def _differing(encoding: Encoding) -> str:
    """What sets an encoding apart."""
    settings = encoding.settings
    return f"{settings.codec} {settings.quantiser}, {settings.frames} frames"
