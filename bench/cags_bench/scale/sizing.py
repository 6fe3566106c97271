"""The sizing table: a scene's cost per viewer, viewers per core, and the gain from sharing."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from cags_bench.bundles import cached_bundle
from cags_bench.jsonl import check
from cags_bench.scale.settings import ScaleSettings
from cags_bench.scale.viewers import ALONE, APART, SAME, Audience, cost_of, lines_of, measured, splats_shown
from cags_bench.sim.bundle import is_bundle
from cags_bench.sim.session import SessionResult
from cags_encoder import EncodeSettings
from cags_server.http.capacity import HEADROOM

CROWD_FPS, CROWD_MBPS, CROWD_CORES, CROWD_RUNS = 5.0, 3.0, 2, 3
"""A crowd for two cores: frames per second and link of each viewer, cores, and runs, each with other walks."""

CROWD_FRAMES = 15


def scenes(settings: ScaleSettings) -> list[str]:
    """Specs of the scenes to play."""
    frames = settings.clip_frames
    return [settings.scene] if settings.scene else [
        f"procedural:size={size},frames={frames}" for size in settings.sizes.split(",")
    ]  # fmt: skip


def viewer_lines(scene: str, settings: ScaleSettings) -> Iterator[dict[str, Any]]:
    """One line per kind of audience of ``scene`` and kind of reference; the default is the first."""
    bundle = _bundle(scene, settings.cache, EncodeSettings(frames=settings.clip_frames))
    ways = [(SAME, "auto"), (APART, "auto"), (ALONE, "auto"), (SAME, "picture"), (SAME, "none")]
    audiences = [Audience(bundle, settings.viewers, settings.mbps, sharing, references) for sharing, references in ways]
    for line in lines_of(measured(audiences, settings.rounds, settings.seed), splats_shown(bundle), HEADROOM):
        yield {"scene": scene, **line}


def crowd_line(settings: ScaleSettings) -> dict[str, Any]:
    """A crowd at few frames per second: the cores that it needs, and its results on the given number of cores."""
    scene = settings.scene or f"procedural:size=30000,frames={CROWD_FRAMES}"
    bundle = _bundle(scene, settings.cache, EncodeSettings(frames=CROWD_FRAMES, fps=CROWD_FPS))
    audience = Audience(bundle, settings.crowd, CROWD_MBPS)
    alone = audience.played(settings.seed)
    (line,) = lines_of({audience: [cost_of(alone)]}, splats_shown(bundle), HEADROOM)
    on_cores = replace(audience, cores=CROWD_CORES)
    runs = [on_cores.played(settings.seed + number * settings.crowd) for number in range(CROWD_RUNS)]
    made = [[len(one.spent.references) for one in run] for run in runs]
    return {
        "scene": scene,
        **line,
        "case": "crowd",
        "fps": CROWD_FPS,
        "cores": round(settings.crowd * line["cpu_ms"] / 1e3, 3),
        "on_cores": CROWD_CORES,
        "missed": [_missed(run) for run in runs],
        "missed_alone": _missed(alone),
        "late": [sum(one.spent.references_late for one in run) for run in runs],
        "references_of_a_viewer": [[min(each), max(each)] for each in made],
        "references_wanted": max(len(one.spent.references) for one in alone),
        "light": [sum(one.spent.light for one in run) for run in runs],
    }


def _missed(run: Sequence[SessionResult]) -> int:
    """Number of frames whose data had not arrived when they were displayed."""
    return sum(one.summary["frames_missed"] for one in run)


def judged(lines: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Checks that these lines allow."""
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
        out.append(check(f"cores for all references of {who}", f"<= {limit:g}", line["cores"], line["cores"] <= limit))
        missed = max(line["missed"])
        out.append(check(f"frames missed by {who} on {line['on_cores']} cores", "<= 0", missed, not missed))
        more = missed - line["missed_alone"]
        out.append(check(f"of these more than with work that takes no time, {who}", "<= 0", more, more <= 0))
        late = max(line["late"])
        out.append(check(f"references late in the worst run of {who}", "<= 0", late, not late))
        least = min(low / high for low, high in line["references_of_a_viewer"])
        out.append(check(f"references of one over those of another, {who}", ">= 0.5", round(least, 2), least >= 0.5))
    return out


def sizing_table(lines: Sequence[dict[str, Any]]) -> str:
    """Markdown table with one row per scene: processor time per viewer and second, and viewers per core."""
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


def sizing_caption(lines: Sequence[dict[str, Any]], where: dict[str, Any]) -> str:
    """What the table's rows are, and where they were measured (:func:`cags_bench.jsonl.provenance`)."""
    line = next(iter(_by_scene(lines).values()))[SAME, "auto"]
    return (
        f"A row is a scene, {line['viewers']} viewers at {line['mbps']:g} Mbps each on walks of their own, medians of "
        f"{line['rounds']} rounds ({where['machine']}; commit {where['commit']}; [lines](sizing.jsonl)). CPU ms are a "
        f"viewer's for each second that it watches; a core carries what takes {HEADROOM:.0%} of it."
    )


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
