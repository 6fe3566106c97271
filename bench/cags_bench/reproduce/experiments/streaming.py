"""Figures of streamed quality: fixed and fluctuating bandwidth, ablations, representations."""

from __future__ import annotations

import hashlib
from pathlib import Path

from cags_bench.jsonl import JsonObject, check
from cags_bench.reproduce.cases import averaged
from cags_bench.reproduce.methods import BASELINES, METHODS
from cags_bench.reproduce.plan import Context
from cags_bench.reproduce.section import Cell, Curve, Plot, Section
from cags_encoder.formats.ply import ply_bytes
from cags_encoder.scenes import open_scene

PSNR, SSIM = "psnr_restored_db", "ssim_restored"
GAIN_TARGET_DB = 5.0

REPRESENTATIONS = {
    "TrackerSplat-like: splats move, colours stay": "rigid",
    "Dynamic 3DGS-like: everything bends": "bend",
    "4DGS-like: shape, place and colour change": "mix",
    "HiCoM-like: splats come and go": "appear",
}
"""Kinds of motion that change what each representation changes between its frames."""


def fixed(context: Context) -> Section:
    """Mean PSNR and SSIM of every method at fixed rates, over all scenes."""
    rows: list[list[Cell]] = []
    curves: dict[str, tuple[list[float], list[float]]] = {}
    checks = []
    for mbps in context.plan.rates_mbps:
        means = {}
        for method in context.plan.methods:
            results = [_run(context, scene, method, mbps) for scene in context.plan.scenes]
            means[method] = averaged(results, PSNR)
            rows.append([METHODS[method].title, mbps, means[method], averaged(results, SSIM), _goodput(results)])
            x, y = curves.setdefault(method, ([], []))
            x.append(mbps)
            y.append(means[method])
        if mbps <= 60:
            checks += _gains(means, f"at {mbps:g} Mbps")
    return Section(
        name="fixed",
        title="Quality under fixed bandwidth",
        paper="Figure 'fixed bandwidth'. The paper's rates, scaled to the same bits a splat and second.",
        columns=("method", "paper's Mbps", "PSNR [dB]", "SSIM", "goodput here [Mbps]"),
        rows=rows,
        plots=[Plot("Mean over scenes", "paper's Mbps", "PSNR [dB]", _curves(curves))],
        notes=[f"{METHODS[m].title}: {METHODS[m].note}." for m in context.plan.methods],
        checks=checks,
    )


def fluctuating(context: Context) -> Section:
    """PSNR a frame over the fluctuating trace."""
    rows: list[list[Cell]] = []
    plots, checks = [], []
    for scene in context.plan.scenes:
        curves, means = [], {}
        for method in context.plan.methods:
            result = _run(context, scene, method, None)
            frames = result["frames"]
            curves.append(Curve(METHODS[method].title, [f["frame"] for f in frames], [f[PSNR] for f in frames]))
            means[method] = result["summary"][PSNR]
            low = sorted(f[PSNR] for f in frames)[len(frames) // 20]
            rows.append([scene, METHODS[method].title, means[method], low, result["summary"][SSIM]])
        plots.append(Plot(scene, "frame", "PSNR [dB]", curves))
        checks += _ahead(means, scene)
    return Section(
        name="fluctuating",
        title="Quality under fluctuating bandwidth",
        paper=f"Figure 'dynamic bandwidth', over {context.plan.trace}, scaled to the same bits a splat and second.",
        columns=("scene", "method", "PSNR [dB]", "5th percentile", "SSIM"),
        rows=rows,
        plots=plots,
        checks=checks,
    )


def ablations(context: Context) -> Section:
    """What alignment and the adaptive field of view each give."""
    rows: list[list[Cell]] = []
    for scene in context.plan.scenes:
        for method in context.plan.ablations:
            summary = _run(context, scene, method, None)["summary"]
            aligned, coverage = summary.get("psnr_aligned_db"), summary.get("aligned_share")
            rows.append([scene, METHODS[method].title, summary[PSNR], summary[SSIM], aligned, coverage])
    return Section(
        name="ablations",
        title="Without alignment, without the adaptive field of view",
        paper="The ablations of figures 'fixed' and 'dynamic bandwidth', over the fluctuating trace.",
        columns=("scene", "method", "PSNR [dB]", "SSIM", "aligned reference [dB]", "share with a reference"),
        rows=rows,
        notes=[f"{METHODS[m].title}: {METHODS[m].note}." for m in context.plan.ablations],
    )


def generality(context: Context) -> Section:
    """Sequences that differ from frame to frame in other ways."""
    rows: list[list[Cell]] = []
    still = _still(context, context.plan.scenes[0])
    for title, kind in REPRESENTATIONS.items():
        scene = f"motion:{still}:kind={kind},frames={context.plan.frames}"
        for method in ("cags", "sr-align-ref", "cr-no-ref", *context.plan.ablations[1:]):
            summary = _run(context, scene, method, None)["summary"]
            rows.append([title, METHODS[method].title, summary[PSNR], summary[SSIM]])
    return Section(
        name="generality",
        title="Other representations of moving Gaussians",
        paper="Figure 'generality'. Stand-ins: the first frame of the first scene, put into motion the way each "
        "representation stores it.",
        columns=("representation", "method", "PSNR [dB]", "SSIM"),
        rows=rows,
    )


def _still(context: Context, scene: str) -> Path:
    """The first frame of ``scene`` as a PLY file in the cache, to be put into motion."""
    data = ply_bytes(open_scene(scene).frame(0))
    folder = context.runner.results.folder.with_name("stills")
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{hashlib.sha256(data).hexdigest()[:16]}.ply"
    if not path.exists():
        path.write_bytes(data)
    return path


def _run(context: Context, scene: str, method: str, mbps: float | None) -> JsonObject:
    context.tell(f"{scene}, {METHODS[method].title}" + ("" if mbps is None else f", {mbps:g} Mbps"))
    return context.runner.run(context.case(scene, method, mbps))


def _goodput(results: list[JsonObject]) -> float:
    return averaged(results, "goodput_mbps")


def _curves(found: dict[str, tuple[list[float], list[float]]]) -> list[Curve]:
    return [Curve(METHODS[method].title, x, y) for method, (x, y) in found.items()]


def _gains(means: dict[str, float], where: str) -> list[JsonObject]:
    rivals = [m for m in ("lts-f", "v3-a") if m in means]
    gains = {m: means["cags"] - means[m] for m in rivals}
    return [
        check(f"over {METHODS[m].title} {where}", f">= {GAIN_TARGET_DB} dB", round(g, 2), g >= GAIN_TARGET_DB)
        for m, g in gains.items()
    ]


def _ahead(means: dict[str, float], scene: str) -> list[JsonObject]:
    best = max((m for m in BASELINES if m in means), key=means.__getitem__)
    lead = means["cags"] - means[best]
    return [
        check(f"ahead of every baseline on {scene}", f"> 0 dB over {METHODS[best].title}", round(lead, 2), lead > 0)
    ]
