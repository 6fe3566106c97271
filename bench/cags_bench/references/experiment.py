"""The experiment behind ``cags-bench references``."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import mean, median

from cags_bench.inputs import check_scenes, check_walks
from cags_bench.jsonl import JsonObject, provenance, summary
from cags_bench.parallel import in_parallel
from cags_bench.programs import executable
from cags_bench.references.before import played_before, read_baseline
from cags_bench.references.cases import Case, cases_of, figures_of
from cags_bench.references.checks import checks_of
from cags_bench.references.methods import EARLIER, METHODS
from cags_bench.references.settings import ReferenceBenchSettings
from cags_bench.sim.session import Scenario, simulate
from cags_client.settings import ClientSettings
from cags_server.settings import ServerSettings


@dataclass(frozen=True)
class Play:
    """A case played with one method."""

    case: Case
    method: str
    before: str = ""
    """Python of the earlier installation, if that is the method."""
    lpips: str = ""

    def line(self) -> JsonObject:
        """Play the case and return its figures."""
        figures = played_before(self.before, self.case) if self.method == EARLIER else self._played()
        return {"benchmark": "references", **self.case.label, "method": self.method, **figures, **provenance()}

    def _played(self) -> JsonObject:
        method, case = METHODS[self.method], self.case
        scenario = Scenario(
            case.bundle(),
            case.trace(),
            case.poses,
            server=ServerSettings(**method.server),
            client=ClientSettings(width=case.width, height=case.height, **method.client),
            lpips=self.lpips,
        )
        result = simulate(scenario)
        spent = result.spent
        return figures_of(result.frames, result.summary) | {
            "server_ms": spent.server_ms_a_frame,
            "server_truth_ms": _median([one.truth_ms for one in spent.references]),
            "server_mirror_ms": _median([one.mirror_ms for one in spent.references]),
            "server_coding_ms": _median([one.coding_ms for one in spent.references]),
            "client_ms": spent.client_ms_a_frame,
        }


def compared(settings: ReferenceBenchSettings) -> Iterator[JsonObject]:
    """One line per case and method, interleaved with an earlier installation; then the summary.

    Raises :class:`CagsError`; wrong inputs are refused before anything is encoded.
    """
    if settings.before:
        executable("before", settings.before)
    check_walks(settings.walk_list)
    check_scenes(settings.scene_list)
    earlier = read_baseline(Path(settings.baseline)) if settings.baseline else []
    methods = [*settings.method_list, *([EARLIER] if settings.before else [])]
    cases = list(cases_of(settings))
    for scene in dict.fromkeys(case.scene for case in cases):  # once, not in every process
        next(case for case in cases if case.scene == scene).bundle()
    plays = [Play(case, method, settings.before, settings.lpips_file) for case in cases for method in methods]
    lines: list[JsonObject] = []
    for line in in_parallel(Play.line, plays, settings.workers):
        lines.append(line)
        yield line
    earlier += [line for line in lines if line["method"] == EARLIER]
    yield summary("references", checks_of(lines, earlier), means=_means(lines), notes=_notes(settings.method_list))


def _notes(methods: Sequence[str]) -> dict[str, str]:
    return {name: METHODS[name].note for name in methods}


AVERAGED = (
    "psnr_db",
    "psnr_p5_db",
    "own_psnr_db",
    "ssim",
    "lpips",
    "flicker",
    "reference_bytes_a_frame",
    "server_ms",
    "client_ms",
)


def _means(lines: Sequence[JsonObject]) -> dict[str, JsonObject]:
    """Means over all cases, by method."""
    out = {}
    for method in dict.fromkeys(str(line["method"]) for line in lines):
        own = [line for line in lines if line["method"] == method]
        found = {key: [float(x[key]) for x in own if _known(x.get(key))] for key in AVERAGED}
        out[method] = {key: mean(values) for key, values in found.items() if values}
    return out


def _known(value: object) -> bool:
    return isinstance(value, int | float) and math.isfinite(value)


def _median(values: Sequence[float]) -> float:
    return median(values) if values else 0.0
