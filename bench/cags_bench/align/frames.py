"""A client's whole frame at each accuracy that it has: what accuracy costs in time, and its lack in quality."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from statistics import median

from cags_bench.align.command import AlignBenchSettings
from cags_bench.jsonl import JsonObject, check, provenance
from cags_bench.restore.cases import Case, Cases
from cags_bench.restore.experiment import scores
from cags_bench.restore.methods import Milliseconds, Watch
from cags_client import align
from cags_client.align import AlignSettings
from cags_client.restore import RestoreInput
from cags_client.restore.affine import AffineRestorer, AffineSettings
from cags_common.geometry import F32
from cags_common.raster.base import Exactness, RenderOptions
from cags_common.raster.halving import enlarged, halved

LIMITS_MS = {"1600x1200": 33.0, "800x600": 16.0}


@dataclass(frozen=True)
class Accuracy:
    """How a client may work out a frame: its own settings ``exactness`` and ``resolution``."""

    exactness: Exactness
    half: bool

    @property
    def name(self) -> str:
        """Of both."""
        return f"{self.exactness}, {'half' if self.half else 'full'} resolution"


ACCURACIES = [Accuracy(exactness, half) for half in (False, True) for exactness in (Exactness.BALANCED, Exactness.FAST)]


class Client:
    """What a client does for a frame, by ``affine`` and without erosion: it looks at no aligned colours."""

    def __init__(self, case: Case, accuracy: Accuracy, threads: int) -> None:
        self._case, self._accuracy, self._threads = case, accuracy, threads
        self._aligner = align.create("auto", AlignSettings(threads=threads))
        self._restorer = AffineRestorer(AffineSettings(threads=threads))
        self._own = case.own()

    def frame(self, *, new_reference: bool) -> tuple[F32, Milliseconds]:
        """The picture [H, W, 3], and milliseconds by stage.

        A frame with a ``new_reference`` draws the client's own view of it and fits the correction to both; the others,
        from the second on, have that from before.
        """
        watch, case = Watch(), self._case
        options = RenderOptions(exactness=self._accuracy.exactness, threads=self._threads, displayed=True)
        camera, half = case.camera, self._accuracy.half
        if half:
            camera, options = halved(camera), replace(options, footprint=options.footprint.at_half_resolution())
        view = case.held.render(camera, options)
        assert view.depth is not None
        watch("raster")
        if new_reference:
            self._own = case.own()
            watch("own")
        aligned = self._aligner.align(case.reference, view.depth, camera)
        watch("align")
        shown = self._restorer.restore(RestoreInput(view.rgb, view.alpha, aligned, case.reference, self._own))
        watch("restore")
        if half:
            shown = enlarged(shown, case.camera, self._threads)
            watch("enlarge")
        return shown, watch.stages_ms


WARM_UP = 2
"""A correction is kept from the second frame on that uses it."""


def frames(cases: Cases, settings: AlignBenchSettings) -> Iterator[JsonObject]:
    """One line a size, LoD and accuracy, of the first view: accuracies interleaved, after a warm-up."""
    for size in settings.size_list:
        for case in cases.ladder(size, settings.error_list[0]):
            clients = {accuracy: Client(case, accuracy, settings.threads) for accuracy in ACCURACIES}
            yield from _frame_lines(clients, case, settings.repetitions)


def _frame_lines(clients: dict[Accuracy, Client], case: Case, repetitions: int) -> Iterator[JsonObject]:
    pictures, with_new = {}, {}
    for accuracy, client in clients.items():
        pictures[accuracy], stages = client.frame(new_reference=True)
        with_new[accuracy] = [stages]
    kept: dict[Accuracy, list[Milliseconds]] = {accuracy: [] for accuracy in clients}
    for repetition in range(WARM_UP + repetitions):
        for accuracy, client in clients.items():
            _, stages = client.frame(new_reference=False)
            if repetition >= WARM_UP or not repetitions:
                kept[accuracy].append(stages)
    for _ in range(repetitions):
        for accuracy, client in clients.items():
            # Pictures that were kept would not be there to be drawn into again: 23 MB of page faults a frame.
            with_new[accuracy].append(client.frame(new_reference=True)[1])
    for accuracy, times in kept.items():
        fresh = [sum(stages.values()) for stages in with_new[accuracy]]
        yield {
            "frame": accuracy.name,
            **case.labels,
            "splats": len(case.splats),
            **{f"{stage}_ms": median(t[stage] for t in times) for stage in times[0]},
            "frame_ms": median(sum(t.values()) for t in times),
            "frame_least_ms": min(sum(t.values()) for t in times),
            "new_reference_frame_ms": median(fresh[1:] or fresh),
            **scores(pictures[accuracy], case, None),
            "warm_up": WARM_UP if repetitions else 0,
            "repetitions": repetitions,
            **provenance(),
        }


def frame_checks(lines: Sequence[JsonObject]) -> Iterator[JsonObject]:
    """Whether a frame whose reference was there before is in time at the lowest LoD, at each accuracy."""
    for size, limit_ms in LIMITS_MS.items():
        found = [line for line in lines if line["size"] == size]
        least = min((line["lod_share"] for line in found), default=0)
        for line in found:
            if line["lod_share"] == least:
                title = f"client frame at {size}: rasterise, align, affine; {line['frame']}"
                yield check(title, f"<= {limit_ms:g} ms", line["frame_ms"], line["frame_ms"] <= limit_ms)


def frame_table(lines: Sequence[JsonObject]) -> dict[str, JsonObject]:
    """By size and LoD: milliseconds with a reference of before and with a new one, PSNR over covered pixels."""
    out: dict[str, JsonObject] = {}
    for line in lines:
        row = out.setdefault(f"{line['size']}, LoD {line['lod_share']:g}", {})
        row[line["frame"]] = {key: line[key] for key in ("frame_ms", "new_reference_frame_ms", "psnr_covered_db")}
    return out
