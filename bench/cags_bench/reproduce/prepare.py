"""Runs the cases of a reproduction ahead, on all cores: encodings, then sessions; each is kept when done."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed

from cags_bench.reproduce.cases import Runner, StreamCase
from cags_bench.reproduce.methods import METHODS
from cags_common.runtime.processes import process_pool

NETWORKS = {"srresnet", "sr-align-ref", "cr-no-ref"}

Tell = Callable[[str], None]


def prepare(runner: Runner, cases: Iterable[StreamCase], workers: int, tell: Tell) -> None:
    """Compute every case that is not there yet. An interrupted run loses only the cases that were being computed."""
    missing = sorted((case for case in dict.fromkeys(cases) if not runner.done(case)), key=_quick)
    if workers < 2 or len(missing) < 2:
        return  # the experiments run them one by one
    one_thread = Runner(runner.results, runner.bundles, runner.device, threads=1, progress=False)
    with process_pool(workers) as pool:
        encodings = {(c.scene, c.encoding): c for c in missing}
        _await(pool, one_thread.bundle, list(encodings.values()), "encoded", tell)
        _await(pool, one_thread.run, missing, "streamed", tell)


def _quick(case: StreamCase) -> tuple[bool, bool]:
    """Sorts what takes longest to the front, so that no core is idle at the end: coding planes, running a network."""
    return case.encoding.codec != "video", METHODS[case.method].client.get("restore") not in NETWORKS


def _await(
    pool: ProcessPoolExecutor, work: Callable[[StreamCase], object], cases: Sequence[StreamCase], done: str, tell: Tell
) -> None:
    futures: dict[Future[object], StreamCase] = {pool.submit(work, case): case for case in cases}
    try:
        for count, future in enumerate(as_completed(futures), start=1):
            future.result()
            tell(f"{done} {count}/{len(cases)}: {describe(futures[future])}")
    except BaseException:
        for future in futures:
            future.cancel()
        raise


def describe(case: StreamCase) -> str:
    """A case in words."""
    return f"{case.scene}, {case.method}" + ("" if case.mbps is None else f", {case.mbps:g} Mbps")
