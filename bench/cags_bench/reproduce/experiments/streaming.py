"""Figures of streamed quality: fixed and fluctuating bandwidth, ablations, representations."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from statistics import mean

from cags_bench.confidence import Interval, interval, interval_of_play, paired, pooled
from cags_bench.jsonl import JsonObject, check
from cags_bench.reproduce.cases import StreamCase, averaged
from cags_bench.reproduce.methods import METHODS
from cags_bench.reproduce.plan import Context
from cags_bench.reproduce.section import Cell, Curve, Picture, Plot, Section, Strip
from cags_encoder.formats.ply import ply_bytes
from cags_encoder.scenes import open_scene

PSNR, SSIM = "psnr_restored_db", "ssim_restored"
FLICKER, LPIPS = "flicker_restored", "lpips_restored"

REPRESENTATIONS = {
    "TrackerSplat-like: splats move, colours stay": "rigid",
    "Dynamic 3DGS-like: everything bends": "bend",
    "4DGS-like: shape, place and colour change": "mix",
    "HiCoM-like: splats come and go": "appear",
}
"""Kinds of motion that change what each representation changes between its frames."""

GENERAL_MBPS = 30.0
"""Where not everything fits; over a link on which all of it does, all methods show the same."""


def fixed_cases(context: Context) -> list[StreamCase]:
    """Every scene, method and rate."""
    p = context.plan
    return [context.case(s, m, rate) for rate in p.rates_mbps for m in p.methods for s in p.scenes]


def fixed(context: Context) -> Section:
    """Mean PSNR and SSIM of every method at fixed rates, over all scenes."""
    rows: list[list[Cell]] = []
    curves: dict[str, tuple[list[float], list[float]]] = {}
    for mbps in context.plan.rates_mbps:
        for method in context.plan.methods:
            results = [context.result(context.case(scene, method, mbps)) for scene in context.plan.scenes]
            rows.append([METHODS[method].title, mbps, *(averaged(results, key) for key in FIGURES.values())])
            x, y = curves.setdefault(method, ([], []))
            x.append(mbps)
            y.append(averaged(results, PSNR))
    slowest = context.plan.rates_mbps[0]
    return Section(
        name="fixed",
        title="Quality under fixed bandwidth",
        paper="Figure 'fixed bandwidth'. The paper's rates, scaled to the same bits a splat and second. A quick run "
        "has VMAF and XPSNR at the slowest rate only.",
        columns=("method", "paper's Mbps", *FIGURES),
        rows=rows,
        plots=[Plot("Mean over scenes", "paper's Mbps", "PSNR [dB]", _curves(curves))],
        strips=[strip(context, scene, slowest) for scene in context.plan.scenes],
        notes=[f"{METHODS[m].title}: {METHODS[m].note}." for m in context.plan.methods],
    )


FIGURES = {
    "PSNR [dB]": PSNR,
    "SSIM": SSIM,
    "LPIPS": LPIPS,
    "VMAF": "vmaf",
    "XPSNR [dB]": "xpsnr_db",
    "JOD": "jod",
    "flicker [1/255]": FLICKER,
    "steps, 95th percentile [dB]": "psnr_restored_step_p95_db",
    "goodput here [Mbps]": "goodput_mbps",
}
"""Columns of streamed results, and where they are in a summary. Flicker is 0 for an error that does not change."""


def fluctuating_cases(context: Context) -> list[StreamCase]:
    """Every scene and method over the trace."""
    return [context.case(s, m) for m in context.plan.methods for s in context.plan.scenes]


def fluctuating(context: Context) -> Section:
    """PSNR a frame over the fluctuating trace."""
    rows: list[list[Cell]] = []
    plots = []
    for scene in context.plan.scenes:
        curves = []
        for method in context.plan.methods:
            result = context.result(context.case(scene, method))
            frames = result["frames"]
            curves.append(Curve(METHODS[method].title, [f["frame"] for f in frames], [f[PSNR] for f in frames]))
            low = sorted(f[PSNR] for f in frames)[len(frames) // 20]
            figures = [result["summary"].get(key) for key in FIGURES.values()]
            rows.append([scene, METHODS[method].title, low, *figures])
        plots.append(Plot(scene, "frame", "PSNR [dB]", curves))
    return Section(
        name="fluctuating",
        title="Quality under fluctuating bandwidth",
        paper=f"Figure 'dynamic bandwidth', over {context.plan.trace}, scaled to the same bits a splat and second. The "
        "clip gets the part of the trace whose middle is the steepest fall.",
        columns=("scene", "method", "PSNR, 5th percentile", *FIGURES),
        rows=rows,
        plots=plots,
        strips=[strip(context, scene, None) for scene in context.plan.scenes],
    )


def range_cases(context: Context) -> list[StreamCase]:
    """Every scene over the trace as recorded."""
    p = context.plan
    return [context.case(s, m, unscaled=True) for m in p.in_range for s in p.scenes]


def unscaled(context: Context) -> Section:
    """The trace with its own rates, and ours against every other method over it."""
    plan = context.plan
    rows: list[list[Cell]] = []
    leads: dict[str, list[list[float]]] = {}
    for scene in plan.scenes:
        ours = _series(context, context.case(scene, "cags", unscaled=True))
        for method in plan.in_range:
            summary = context.result(context.case(scene, method, unscaled=True))["summary"]
            theirs = _series(context, context.case(scene, method, unscaled=True))
            lead = paired(ours, theirs)
            low = sorted(theirs)[len(theirs) // 20]
            cells = [summary[PSNR], low, summary["goodput_mbps"], summary["frames_missed"]]
            beside: list[Cell] = [None] * 3 if method == "cags" else [lead.mean, lead.low, lead.high]
            rows.append([scene, METHODS[method].title, *cells, *beside])
            if method != "cags":
                leads.setdefault(method, []).append(_differences(ours, theirs))
    return Section(
        name="range",
        title="The fluctuating link as recorded",
        paper=f"Figure 'dynamic bandwidth' over {plan.trace}, unscaled: the recorded rates, 1.5 to 252 Mbps in the "
        "paper's segment, around the steepest fall. Scenes here have fewer splats than the paper's, so the fast part "
        "carries everything and what is tested is the fall.",
        columns=(
            "scene",
            "method",
            "PSNR [dB]",
            "PSNR, 5th percentile",
            "goodput here [Mbps]",
            "frames missed",
            "ours is ahead by [dB]",
            "95 % from",
            "to",
        ),
        rows=rows,
        notes=[f"{METHODS[m].title}: {METHODS[m].note}." for m in plan.in_range],
        checks=[
            check(f"ahead of {METHODS[m].title} over the link as recorded", "> 0 dB", f"{found} dB", found.above(0.0))
            for m, found in ((method, pooled(series)) for method, series in leads.items())
        ],
    )


def _series(context: Context, case: StreamCase) -> list[float]:
    """PSNR by frame."""
    return [float(frame[PSNR]) for frame in context.result(case)["frames"]]


def strip(context: Context, scene: str, mbps: float | None) -> Strip:
    """The truth and what every method showed of it, at one frame."""
    results = {m: context.result(context.case(scene, m, mbps)) for m in context.plan.methods}
    truths = [r["pictures"]["truth"] for r in results.values() if r["pictures"]]
    pictures = [Picture("truth", truths[0])] if truths else []
    for method, result in results.items():
        if result["pictures"]:
            label = f"{METHODS[method].title}, {_db_at_picture(context, result)}"
            pictures.append(Picture(label, result["pictures"]["shown"]))
    link = context.plan.trace if mbps is None else f"{mbps:g} Mbps"
    return Strip(f"{scene}, {link}, frame {2 * context.plan.frames // 3} (the middle of the picture)", pictures)


def _db_at_picture(context: Context, result: JsonObject) -> str:
    at = 2 * context.plan.frames // 3
    return next((f"{f[PSNR]:.1f} dB" for f in result["frames"] if f["frame"] == at), "not shown")


ABLATION_MBPS = (30.0, 60.0)
"""Where something is at stake: the rates at which not everything fits."""

PARTS = (
    ("PRPA", "cags-paper", "no-prpa"),
    ("restoration, as published", "cags-paper", "paper-no-restoration"),
    ("the adaptive field of view, as published", "cags-paper", "paper-no-adaptive-fov"),
    ("references", "cags", "cr-no-ref"),
    ("references that are differences", "cags", "pictures"),
    ("the adaptive field of view", "cags", "no-adaptive-fov"),
    ("the measured order of layers", "cags", "printed-order"),
    ("levels chosen tile by tile", "cags", "one-level"),
    ("motion apart from looks", "cags", "whole-splats"),
)
"""A part, a method with it, and the same without."""

NEEDED = "only the effects needed"
EQUAL_DB = 0.05
"""How far leaving out what is not needed may move a picture, either way."""


def ablation_cases(context: Context) -> list[StreamCase]:
    """Ours and the published way, and each without one part."""
    p = context.plan
    return [context.case(s, m, mbps) for s in p.scenes for mbps in ABLATION_MBPS for m in p.ablations]


def ablations(context: Context) -> Section:
    """What each part brings and costs, scene by scene and over all of them, with intervals."""
    rows: list[list[Cell]] = []
    for part, with_it, without in (*PARTS, (NEEDED, "cags", "all-effects")):
        for mbps in ABLATION_MBPS:
            gains = {s: _gain_by_frame(context, s, mbps, with_it, without) for s in context.plan.scenes}
            found: dict[str, tuple[Interval, Sequence[Cell]]] = {
                s: (interval_of_play(gains[s]), _costs(context, [s], mbps, with_it, without)) for s in gains
            }
            every = _costs(context, context.plan.scenes, mbps, with_it, without)
            found["all scenes"] = pooled(list(gains.values())), every
            head = part, METHODS[with_it].title, link_title(mbps)
            rows += [[*head, s, one.mean, one.low, one.high, *costs] for s, (one, costs) in found.items()]
    return Section(
        name="ablations",
        title="What each effect costs and brings",
        paper="The ablations of figures 'fixed' and 'dynamic bandwidth', at 30 and 60 Mbps: PSNR with the part less "
        "PSNR without, paired frame by frame; 95 % intervals are of this walk, in blocks of nine frames. Costs are "
        "with the part less without: processor time a frame shown, and all bytes that arrived.",
        columns=(
            "part",
            "of",
            "link",
            "scene",
            "brings [dB]",
            "95 % from",
            "to",
            "server [ms a frame]",
            "client [ms a frame]",
            "kB a frame",
        ),
        rows=rows,
        notes=[
            "Times are of sessions that ran one a core and shared caches: read them to a millisecond.",
            *(f"{METHODS[m].title}: {METHODS[m].note}." for m in context.plan.ablations),
        ],
        checks=[*(_brings(context, *part) for part in PARTS), *_needed(context)],
    )


def _gain_by_frame(context: Context, scene: str, mbps: float, with_it: str, without: str) -> list[float]:
    """PSNR by frame with a part less PSNR without."""
    ours, theirs = (_series(context, context.case(scene, method, mbps)) for method in (with_it, without))
    return _differences(ours, theirs)


def _differences(ours: Sequence[float], theirs: Sequence[float]) -> list[float]:
    return [a - b for a, b in zip(ours, theirs, strict=True)]


def _costs(context: Context, scenes: Sequence[str], mbps: float, with_it: str, without: str) -> list[float]:
    """Server ms, client ms and kB a frame with a part less those without, means over ``scenes``."""
    found = []
    for method in (with_it, without):
        results = [context.result(context.case(scene, method, mbps)) for scene in scenes]
        found.append([_mean(cost(one) for one in results) for cost in COSTS])
    return _differences(*found)


COSTS: tuple[Callable[[JsonObject], float], ...] = (
    lambda one: float(one["spent"]["server_ms"]),
    lambda one: float(one["spent"]["client_ms"]),
    lambda one: (one["summary"]["bytes_tiles"] + one["summary"]["bytes_reference"]) / 1e3 / len(one["frames"]),
)
"""What a session spends a frame."""


def _mean(values: Iterable[float]) -> float:
    return float(mean(values))


def _brings(context: Context, part: str, with_it: str, without: str) -> JsonObject:
    """Whether ``part`` is sure to bring something at 30 Mbps, over all scenes."""
    mbps = ABLATION_MBPS[0]
    found = pooled([_gain_by_frame(context, scene, mbps, with_it, without) for scene in context.plan.scenes])
    return check(f"{part}: brings something at {link_title(mbps)}", "> 0 dB", f"{found} dB", found.above(0.0))


def _needed(context: Context) -> list[JsonObject]:
    """Leaving out what is not needed changes nothing that is seen, either way, and takes no more time."""
    mbps, scenes = ABLATION_MBPS[0], context.plan.scenes
    found = pooled([_gain_by_frame(context, scene, mbps, "cags", "all-effects") for scene in scenes])
    saved = interval([-_costs(context, [scene], mbps, "cags", "all-effects")[1] for scene in scenes])
    equal = found.low > -EQUAL_DB and found.high < EQUAL_DB
    return [
        check(f"{NEEDED}: the picture stays", f"within {EQUAL_DB} dB", f"{found} dB", equal),
        check(f"{NEEDED}: the client saves time", "> 0 ms a frame", f"{saved} ms", saved.above(0.0)),
    ]


def link_title(mbps: float | None) -> str:
    """A link in words."""
    return "fluctuating" if mbps is None else f"{mbps:g} Mbps"


def generality_cases(context: Context) -> list[StreamCase]:
    """Every representation and method."""
    return [context.case(s, m, GENERAL_MBPS) for s in _representations(context).values() for m in context.plan.general]


def generality(context: Context) -> Section:
    """Sequences that differ from frame to frame in other ways."""
    rows: list[list[Cell]] = []
    leads: dict[str, list[list[float]]] = {}
    equal = 0
    for title, scene in _representations(context).items():
        series = {
            method: _series(context, context.case(scene, method, GENERAL_MBPS)) for method in context.plan.general
        }
        equal += len(series) - len({tuple(one) for one in series.values()})
        for method, theirs in series.items():
            summary = context.result(context.case(scene, method, GENERAL_MBPS))["summary"]
            lead = paired(series["cags"], theirs)
            beside: list[Cell] = [None] * 3 if method == "cags" else [lead.mean, lead.low, lead.high]
            figures = summary[PSNR], summary[SSIM], summary.get(FLICKER), summary["bytes_tiles"] / 1e3 / len(theirs)
            rows.append([title, METHODS[method].title, *figures, *beside])
            if method != "cags":
                leads.setdefault(method, []).append(_differences(series["cags"], theirs))
    found = {method: pooled(series) for method, series in leads.items()}
    return Section(
        name="generality",
        title="Other representations of moving Gaussians",
        paper=f"Figure 'generality', at {GENERAL_MBPS:g} Mbps of the paper, where not everything fits. Stand-ins: the "
        "first frame of the first scene, put into motion the way each representation stores it; no scene here was "
        "trained by these methods.",
        columns=(
            "representation",
            "method",
            "PSNR [dB]",
            "SSIM",
            "flicker [1/255]",
            "tiles [kB a frame]",
            "ours is ahead by [dB]",
            "95 % from",
            "to",
        ),
        rows=rows,
        notes=[f"{METHODS[m].title}: {METHODS[m].note}." for m in context.plan.general]
        + (["The published way and its ablations are left out of a quick run."] if context.plan.quick else []),
        checks=[
            check("no two methods show the same on any representation", "0 pairs", equal, equal == 0),
            *(
                check(f"ahead of {METHODS[m].title} on every kind of motion", "> 0 dB", f"{one} dB", one.above(0.0))
                for m, one in found.items()
            ),
        ],
    )


def _representations(context: Context) -> dict[str, str]:
    still = _still(context, context.plan.scenes[0])
    frames = context.plan.frames
    return {title: f"motion:{still}:kind={kind},frames={frames}" for title, kind in REPRESENTATIONS.items()}


def _still(context: Context, scene: str) -> Path:
    """The first frame of ``scene`` as a PLY file in the cache, to be put into motion."""
    data = ply_bytes(open_scene(scene).frame(0))
    folder = context.runner.results.folder.with_name("stills")
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{hashlib.sha256(data).hexdigest()[:16]}.ply"
    if not path.exists():
        path.write_bytes(data)
    return path


def _curves(found: Mapping[str, tuple[Sequence[float], Sequence[float]]]) -> list[Curve]:
    return [Curve(METHODS[method].title, x, y) for method, (x, y) in found.items()]
