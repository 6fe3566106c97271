"""Figures of streamed quality: fixed and fluctuating bandwidth, ablations, representations."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path

from cags_bench.confidence import paired, pooled
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

GENERAL_METHODS = ("cags", "sr-align-ref", "cr-no-ref", "no-adaptive-fov")


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
        paper="Figure 'fixed bandwidth'. The paper's rates, scaled to the same bits a splat and second.",
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
        paper=f"Figure 'dynamic bandwidth', over {context.plan.trace}, scaled to the same bits a splat and second.",
        columns=("scene", "method", "PSNR, 5th percentile", *FIGURES),
        rows=rows,
        plots=plots,
        strips=[strip(context, scene, None) for scene in context.plan.scenes],
    )


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
)
"""A part, a method with it, and the same without."""


def ablation_cases(context: Context) -> list[StreamCase]:
    """Ours and the published way, and each without one part."""
    p = context.plan
    return [context.case(s, m, mbps) for s in p.scenes for mbps in ABLATION_MBPS for m in p.ablations]


def ablations(context: Context) -> Section:
    """What each part brings, scene by scene and over all of them, with intervals."""
    rows: list[list[Cell]] = []
    for part, with_it, without in PARTS:
        for mbps in ABLATION_MBPS:
            gains = {scene: _gains(context, scene, mbps, with_it, without) for scene in context.plan.scenes}
            found = {scene: paired(*series) for scene, series in gains.items()}
            found["all scenes"] = pooled([_differences(*series) for series in gains.values()])
            of = METHODS[with_it].title
            rows += [[part, of, link_title(mbps), s, one.mean, one.low, one.high] for s, one in found.items()]
    return Section(
        name="ablations",
        title="What each part brings",
        paper="The ablations of figures 'fixed' and 'dynamic bandwidth', at 30 and 60 Mbps: PSNR with the part less "
        "PSNR without, paired frame by frame; 95 % intervals are of this walk, in blocks of nine frames.",
        columns=("part", "of", "link", "scene", "brings [dB]", "95 % from", "to"),
        rows=rows,
        notes=[f"{METHODS[m].title}: {METHODS[m].note}." for m in context.plan.ablations],
        checks=[_brings(context, *part) for part in PARTS],
    )


def _gains(
    context: Context, scene: str, mbps: float, with_it: str, without: str
) -> tuple[Sequence[float], Sequence[float]]:
    """PSNR by frame of both methods."""
    played = [context.result(context.case(scene, method, mbps))["frames"] for method in (with_it, without)]
    ours, theirs = ([float(frame[PSNR]) for frame in frames] for frames in played)
    return ours, theirs


def _differences(ours: Sequence[float], theirs: Sequence[float]) -> list[float]:
    return [a - b for a, b in zip(ours, theirs, strict=True)]


def _brings(context: Context, part: str, with_it: str, without: str) -> JsonObject:
    """Whether ``part`` is sure to bring something at 30 Mbps, over all scenes."""
    mbps = ABLATION_MBPS[0]
    gains = (_gains(context, scene, mbps, with_it, without) for scene in context.plan.scenes)
    found = pooled([_differences(*series) for series in gains])
    return check(f"{part}: brings something at {link_title(mbps)}", "> 0 dB", f"{found} dB", found.above(0.0))


def link_title(mbps: float | None) -> str:
    """A link in words."""
    return "fluctuating" if mbps is None else f"{mbps:g} Mbps"


def covered_share(frames: Sequence[JsonObject]) -> float | None:
    """Mean share of the view of which references said anything, over frames that used one; None: none did."""
    found = [float(frame["aligned_share"]) for frame in frames if frame.get("aligned_share")]
    return sum(found) / len(found) if found else None


def generality_cases(context: Context) -> list[StreamCase]:
    """Every representation and method over the trace."""
    return [context.case(s, m) for s in _representations(context).values() for m in GENERAL_METHODS]


def generality(context: Context) -> Section:
    """Sequences that differ from frame to frame in other ways."""
    rows: list[list[Cell]] = []
    for title, scene in _representations(context).items():
        for method in GENERAL_METHODS:
            summary = context.result(context.case(scene, method))["summary"]
            rows.append([title, METHODS[method].title, summary[PSNR], summary[SSIM], summary.get(FLICKER)])
    return Section(
        name="generality",
        title="Other representations of moving Gaussians",
        paper="Figure 'generality'. Stand-ins: the first frame of the first scene, put into motion the way each "
        "representation stores it.",
        columns=("representation", "method", "PSNR [dB]", "SSIM", "flicker [1/255]"),
        rows=rows,
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
