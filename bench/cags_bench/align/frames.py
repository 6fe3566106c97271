"""A client's whole frame at each accuracy that it has: what accuracy costs in time, and its lack in quality."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from statistics import median

import numpy as np

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

    def __init__(self, threads: int) -> None:
        self._threads = threads
        self._aligner = align.create("auto", AlignSettings(threads=threads))
        self._restorer = AffineRestorer(AffineSettings(threads=threads))

    def frame(self, case: Case, accuracy: Accuracy) -> tuple[F32, Milliseconds]:
        """The picture [H, W, 3], and milliseconds by stage."""
        watch = Watch()
        options = RenderOptions(exactness=accuracy.exactness, threads=self._threads)
        camera = case.camera
        if accuracy.half:
            camera, options = halved(camera), replace(options, footprint=options.footprint.at_half_resolution())
        view = case.held.render(camera, options)
        assert view.depth is not None
        distorted = np.clip(view.rgb, 0.0, 1.0, out=view.rgb)
        watch("raster")
        own = case.own()
        watch("own")
        aligned = self._aligner.align(case.reference, view.depth, camera)
        watch("align")
        shown = self._restorer.restore(RestoreInput(distorted, view.alpha, aligned, case.reference, own))
        watch("restore")
        if accuracy.half:
            shown = enlarged(shown, case.camera, self._threads)
            watch("enlarge")
        return shown, watch.stages_ms


def frames(cases: Cases, settings: AlignBenchSettings) -> Iterator[JsonObject]:
    """One line a size, LoD and accuracy, of the first view: accuracies interleaved, after a warm-up."""
    client = Client(settings.threads)
    for size in settings.size_list:
        for case in cases.ladder(size, settings.error_list[0]):
            yield from _frame_lines(client, case, settings.repetitions)


def _frame_lines(client: Client, case: Case, repetitions: int) -> Iterator[JsonObject]:
    first = {accuracy: client.frame(case, accuracy) for accuracy in ACCURACIES}
    times = {accuracy: [] if repetitions else [stages] for accuracy, (_, stages) in first.items()}
    for _ in range(repetitions):
        for accuracy in ACCURACIES:
            times[accuracy].append(client.frame(case, accuracy)[1])
    for accuracy, (picture, stages) in first.items():
        yield {
            "frame": accuracy.name,
            **case.labels,
            "splats": len(case.splats),
            **{f"{stage}_ms": median(t[stage] for t in times[accuracy]) for stage in stages},
            "frame_ms": median(map(_frame_ms, times[accuracy])),
            "frame_least_ms": min(map(_frame_ms, times[accuracy])),
            **scores(picture, case, None),
            "warm_up": 1 if repetitions else 0,
            "repetitions": repetitions,
            **provenance(),
        }


def _frame_ms(stages: Milliseconds) -> float:
    """Of a frame whose reference was there before: the own view is drawn once a reference."""
    return sum(ms for stage, ms in stages.items() if stage != "own")


def frame_checks(lines: Sequence[JsonObject]) -> Iterator[JsonObject]:
    """Whether a frame is in time at the lowest LoD, at each accuracy."""
    for size, limit_ms in LIMITS_MS.items():
        found = [line for line in lines if line["size"] == size]
        least = min((line["lod_share"] for line in found), default=0)
        for line in found:
            if line["lod_share"] == least:
                title = f"client frame at {size}: rasterise, align, affine; {line['frame']}"
                yield check(title, f"<= {limit_ms:g} ms", line["frame_ms"], line["frame_ms"] <= limit_ms)


def frame_table(lines: Sequence[JsonObject]) -> dict[str, JsonObject]:
    """By size and LoD: milliseconds and PSNR over covered pixels at each accuracy."""
    out: dict[str, JsonObject] = {}
    for line in lines:
        row = out.setdefault(f"{line['size']}, LoD {line['lod_share']:g}", {})
        row[line["frame"]] = {"ms": line["frame_ms"], "psnr_covered_db": line["psnr_covered_db"]}
    return out
