"""The sizing table: what a viewer of a scene costs, how many a core carries, and what sharing spares."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from cags_bench.bundles import cached_bundle
from cags_bench.jsonl import check
from cags_bench.scale.cluster import Cluster, Load
from cags_bench.scale.settings import ScaleSettings
from cags_bench.scale.viewers import ALONE, APART, SAME, Audience, lines_of, measured, splats_shown
from cags_bench.sim.bundle import is_bundle
from cags_encoder import EncodeSettings
from cags_server.http.capacity import HEADROOM

CROWD_FPS, CROWD_MBPS, CROWD_CORES, CROWD_RUNS = 5.0, 3.0, 2, 3
"""A crowd that two cores are to carry: frames a second and link of each viewer; runs of the model."""

CROWD_FRAMES = 15

STEADY_S = 1e4
"""Nobody leaves a crowd."""


def scenes(settings: ScaleSettings) -> list[str]:
    """What is watched."""
    frames = settings.clip_frames
    return [settings.scene] if settings.scene else [
        f"procedural:size={size},frames={frames}" for size in settings.sizes.split(",")
    ]  # fmt: skip


def viewer_lines(scene: str, settings: ScaleSettings) -> Iterator[dict[str, Any]]:
    """A line for each way to watch ``scene``, and for each kind of reference; the shipped way is the first."""
    bundle = _bundle(scene, settings.cache, EncodeSettings(frames=settings.clip_frames))
    ways = [(SAME, "auto"), (APART, "auto"), (ALONE, "auto"), (SAME, "picture"), (SAME, "none")]
    audiences = [Audience(bundle, settings.viewers, settings.mbps, sharing, references) for sharing, references in ways]
    for line in lines_of(measured(audiences, settings.rounds, settings.seed), splats_shown(bundle), HEADROOM):
        yield {"scene": scene, **line}


def crowd_line(settings: ScaleSettings) -> dict[str, Any]:
    """A crowd at few frames a second: the cores that it needs, and references that the model of a server has late."""
    scene = f"procedural:size=30000,frames={CROWD_FRAMES}"
    bundle = _bundle(settings.scene or scene, settings.cache, EncodeSettings(frames=CROWD_FRAMES, fps=CROWD_FPS))
    audience = Audience(bundle, settings.crowd, CROWD_MBPS)
    (line,) = lines_of(measured([audience], 1, settings.seed), splats_shown(bundle), HEADROOM)
    load = Load(
        settings.crowd, job_ms=line["job_ms"], workers=CROWD_CORES, fps=CROWD_FPS, stay_s=STEADY_S,
        seconds=settings.seconds,
    )  # fmt: skip
    late = [
        Cluster(1, replace(load, seed=seed)).run().late for seed in range(settings.seed, settings.seed + CROWD_RUNS)
    ]
    cores = settings.crowd * line["cpu_ms"] / 1e3
    return {
        "scene": settings.scene or scene,
        **line,
        "case": "crowd",
        "fps": CROWD_FPS,
        "cores": round(cores, 3),
        "late": late,
    }


def judged(lines: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Checks that these lines can answer."""
    out = []
    for scene, ways in _by_scene(lines).items():
        name = _name(scene, ways[SAME, "auto"])
        carried = ways[SAME, "auto"]["viewers_a_core"]
        mbps = ways[SAME, "auto"]["mbps"]
        out.append(check(f"viewers a core at {mbps:g} Mbps, {name}", ">= 1", carried, carried >= 1))
        ratio = round(ways[ALONE, "auto"]["cpu_ms"] / ways[SAME, "auto"]["cpu_ms"], 3)
        out.append(check(f"processor time without sharing over with, {name}", ">= 1", ratio, ratio >= 1))
    for line in (line for line in lines if line["case"] == "crowd"):
        who = f"{line['viewers']} viewers at {line['fps']:g} frames a second and {line['mbps']:g} Mbps"
        limit = CROWD_CORES * HEADROOM
        out.append(check(f"cores for {who}", f"<= {limit:g}", line["cores"], line["cores"] <= limit))
        out.append(check(f"frames missed by {who}", "<= 0", line["missed"], not line["missed"]))
        late = max(line["late"])
        out.append(check(f"references late in the model's worst run, {who}", "<= 0", late, not late))
    return out


def sizing_table(lines: Sequence[dict[str, Any]]) -> str:
    """Markdown: a row a scene, processor time a viewer and second, and viewers a core."""
    rows = []
    for ways in _by_scene(lines).values():
        best = ways[SAME, "auto"]
        parts = (best[name] for name in ("truth_ms", "mirror_ms", "coding_ms", "serving_ms"))
        cells = [
            f"{best['splats']:,}",
            *(f"{ways[way, 'auto']['cpu_ms']:.0f}" for way in (SAME, APART, ALONE)),
            " + ".join(f"{part:.0f}" for part in parts),
            *(f"{ways[SAME, kind]['viewers_a_core']:.1f}" for kind in ("auto", "picture", "none")),
            f"{ways[ALONE, 'auto']['viewers_a_core']:.1f}",
            f"{best['mirror_mb']:.1f}",
        ]
        rows.append("| " + " | ".join(cells) + " |")
    return "\n".join([*HEADER, *rows]) + "\n"


HEADER = (
    "| splats | CPU ms, same moment | moments apart | nothing shared | of the first: truth + mirror + coding + rest "
    "| viewers a core | with `picture` | with `none` | nothing shared | mirror, MB |",
    "|" + "---|" * 10,
)


def _by_scene(lines: Sequence[dict[str, Any]]) -> dict[str, dict[tuple[str, str], dict[str, Any]]]:
    found: dict[str, dict[tuple[str, str], dict[str, Any]]] = {}
    for line in lines:
        if line["case"] == "viewers":
            found.setdefault(line["scene"], {})[line["sharing"], line["references"]] = line
    return found


def _name(scene: str, line: dict[str, Any]) -> str:
    return f"{line['splats']:,} splats" if scene.startswith("procedural:") else scene


def _bundle(scene: str, cache: str, settings: EncodeSettings) -> Path:
    return Path(scene) if is_bundle(scene) else cached_bundle(scene, cache, settings, progress=False)
