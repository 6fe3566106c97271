"""Sessions of moving scenes over thin links, in virtual time with default settings: quality once they have begun."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cags_bench.bundles import cached_bundle
from cags_bench.jsonl import JsonObject, check, provenance
from cags_bench.motion.settings import MotionSettings
from cags_bench.sim.session import Scenario, simulate
from cags_bench.traces import scaled_trace
from cags_client.settings import ClientSettings
from cags_encoder import EncodeSettings

FRAMES, FPS = 90, 30
WIDTH_PX, HEIGHT_PX = 640, 480
DEMO_SHARE = 0.12
"""Share of the trace's rate in ``cags-demo``."""


@dataclass(frozen=True)
class Goal:
    """What a figure of a session must be at least."""

    figure: str
    least: float


@dataclass(frozen=True)
class Session:
    """A scene over a link, and its goals."""

    name: str
    scene: str
    trace: str
    goals: tuple[Goal, ...]
    share: float = 1.0


def sessions_of(settings: MotionSettings) -> list[Session]:
    """The sessions whose scenes are at hand."""
    folder = Path(settings.shared) / "scenes"
    head, monkey = folder / "talking_head" / "params.npz", folder / "monkey"
    known = [
        Session(
            "talking head, 4 Mbps",
            f"{head}:up=y",
            "generated:steady-4",
            (Goal("mean_db", 42.0), Goal("steps_within_2_db", 0.95)),
        ),
        Session("monkey, lte-driving", str(monkey), "generated:lte-driving", (Goal("steps_within_3_db", 0.95),)),
    ]
    there = [session for session in known if Path(session.scene.removesuffix(":up=y")).exists()]
    demo = Session(
        "the demo's link",
        "procedural:size=30000,frames=90",
        "generated:lte-driving",
        (Goal("lowest_db", 34.0),),
        DEMO_SHARE,
    )
    return [*there, demo]


def played(session: Session, settings: MotionSettings, seed: int) -> JsonObject:
    """Play a session once. ``seed`` chooses walk and part of the trace; 0 is what ``cags-bench stream`` plays."""
    bundle = cached_bundle(session.scene, settings.cache, EncodeSettings(frames=FRAMES), progress=False)
    trace = session.trace if session.share == 1 else str(scaled_trace(session.trace, session.share, seconds=60))
    client = ClientSettings(width=WIDTH_PX, height=HEIGHT_PX)
    result = simulate(Scenario(bundle, trace, "synthetic:walking", client=client, seed=seed))
    psnr = [float(frame["psnr_covered_restored_db"]) for frame in result.frames]
    figures = quality_of(psnr, [int(frame["frame"]) for frame in result.frames])
    line = {"benchmark": "motion", "part": "sessions", "case": session.name, "scene": session.scene, "seed": seed}
    return line | figures | {"frames_missed": result.summary["frames_missed"], **provenance()}


def quality_of(psnr_db: list[float], frames: list[int]) -> JsonObject:
    """Figures of displayed ``frames`` after the first second, from their PSNR over covered pixels.

    A step is the change of PSNR from one displayed picture to the next.
    """
    late = [value for value, frame in zip(psnr_db, frames, strict=True) if frame >= FPS]
    steps = np.abs(np.diff(late))
    return {
        "mean_db": round(float(np.mean(late)), 2),
        "lowest_db": round(float(np.min(late)), 2),
        "steps_p95_db": round(float(np.percentile(steps, 95)), 2),
        "steps_within_2_db": round(float(np.mean(steps <= 2)), 3),
        "steps_within_3_db": round(float(np.mean(steps <= 3)), 3),
    }


def goal_checks(session: Session, lines: list[JsonObject]) -> list[JsonObject]:
    """One check per goal: of the mean over plays, but of the worst play where the figure is itself a lowest one."""
    out = []
    for goal in session.goals:
        values = [float(line[goal.figure]) for line in lines]
        value = min(values) if goal.figure == "lowest_db" else float(np.mean(values))
        out.append(check(f"{session.name}: {goal.figure}", f">= {goal.least:g}", round(value, 3), value >= goal.least))
    return out
