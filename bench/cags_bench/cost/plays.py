"""Stages over whole sessions in virtual time: what settings of encoder and server bring to a viewer, and what both
sides spend for it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from statistics import mean
from typing import Any

from cags_bench.confidence import BLOCK_FRAMES
from cags_bench.cost.engine import BEST_DB, Measured, Outcome, Stage
from cags_bench.cost.moments import bundle_of, link_of
from cags_bench.cost.settings import CostSettings, Size
from cags_bench.parallel import in_parallel
from cags_bench.sim.session import Scenario, SessionResult, simulate
from cags_client.settings import ClientSettings
from cags_encoder import EncodeSettings
from cags_server.fov import FOV_POLICIES
from cags_server.predict import PREDICTORS
from cags_server.ratecontrol import RATE_POLICIES
from cags_server.settings import ServerSettings

SIDE = "server and client"

QUALITY = "psnr_covered_db"

COSTS = "kb_a_frame", "flicker"
"""What counts beside processor time: bytes of tiles and references, and flicker in steps of 1/255."""


@dataclass(frozen=True)
class Variant:
    """Settings of a session; all others are the defaults."""

    server: ServerSettings = field(default_factory=ServerSettings)
    encode: EncodeSettings = field(default_factory=EncodeSettings)


@dataclass(frozen=True)
class Play:
    """One session: everything that decides its result."""

    settings: CostSettings
    scene: str
    size: Size
    seed: int
    variant: Variant

    def encoded(self) -> Path:
        """The bundle. The scene's splats must have been linked before (:func:`.moments.bundle_of`)."""
        return bundle_of(self.scene, self.settings, self.variant.encode)

    def played(self) -> Played:
        """Play it on one thread, so that processor times of plays side by side compare."""
        link = link_of(bundle_of(self.scene, self.settings), self.settings)
        scenario = Scenario(
            self.encoded(),
            link,
            self.settings.poses,
            server=replace(self.variant.server, render_threads=1),
            client=ClientSettings(width=self.size[0], height=self.size[1], threads=1),
            seed=self.seed,
        )
        return played(simulate(scenario))


@dataclass(frozen=True)
class Played:
    """What is kept of a session."""

    parts: tuple[Outcome, ...]
    """Means over :data:`BLOCK_FRAMES` frames each, in order."""
    spent_ms: float
    """Processor time of both sides for a frame."""


def played(result: SessionResult) -> Played:
    """A session in parts. Frames whose picture covers nothing have no quality and are left out of it."""
    spent, frames = result.spent, result.frames
    server_ms = spent.server_ms_a_frame + spent.serving_ms / max(spent.frames, 1)
    sides = {"server_ms": server_ms, "client_ms": spent.client_ms_a_frame}
    count = max(1, len(frames) // BLOCK_FRAMES)
    bounds = [len(frames) * part // count for part in range(count + 1)]
    parts = [_part(frames[low:high]) | sides for low, high in pairwise(bounds) if low < high]
    return Played(tuple(parts), sum(sides.values()))


def _part(frames: Sequence[Mapping[str, Any]]) -> Outcome:
    figures = {
        QUALITY: [min(value, BEST_DB) for value in _known(frames, "psnr_covered_restored_db")],
        "flicker": _known(frames, "flicker_restored"),
        "kb_a_frame": [(frame["bytes_tiles"] + frame["bytes_reference"]) / 1e3 for frame in frames],
        "reference_kb_a_frame": [frame["bytes_reference"] / 1e3 for frame in frames],
    }
    return {key: mean(values) if values else math.nan for key, values in figures.items()}


def _known(frames: Iterable[Mapping[str, Any]], key: str) -> list[float]:
    values = (frame.get(key) for frame in frames)
    return [float(value) for value in values if value is not None and not math.isnan(value)]


Choices = dict[str, Variant]
"""Values of a setting by their labels."""


def choices() -> dict[tuple[str, str], Choices]:
    """What is compared, by name of the stage and of the setting. Defaults come from the settings' own classes."""
    return {
        ("session: rate policy", "abr"): _server("abr", RATE_POLICIES.names()),
        ("session: prediction", "predictor"): _server("predictor", PREDICTORS.names()),
        ("session: field of view", "fov"): _server("fov", FOV_POLICIES.names()),
        ("session: lead", "lead_frames"): _server("lead_frames", (2, 4, 6, 8)),
        ("session: references", "references"): _server("references", ("none", "picture", "difference", "auto")),
        ("session: interval of references", "reference_every"): _server("reference_every", (1, 2, 4)),
        ("session: size of references", "width x height"): _reference_sizes(),
        ("session: quality of references", "reference_crf"): _server("reference_crf", (16.0, 20.0, 24.0, 28.0)),
        ("session: motion", "motion"): _encoder("motion", ("none", "tracks")),
        ("session: tolerance of motion", "change_threshold"): _encoder("change_threshold", (0.04, 0.02, 0.01, 0.005)),
        ("session: order of layers", "lod_order"): _encoder("lod_order", ("paper", "measured")),
    }


def _server(name: str, values: Iterable[Any]) -> Choices:
    server = ServerSettings()
    return {_text(v): Variant(server=replace(server, **{name: v})) for v in _with(values, getattr(server, name))}


def _encoder(name: str, values: Iterable[Any]) -> Choices:
    encode = EncodeSettings()
    return {_text(v): Variant(encode=replace(encode, **{name: v})) for v in _with(values, getattr(encode, name))}


def _reference_sizes() -> Choices:
    server = ServerSettings()
    sizes = sorted({(200, 150), (400, 300), (800, 600), (server.reference_width, server.reference_height)})
    return {f"{w}x{h}": Variant(server=replace(server, reference_width=w, reference_height=h)) for w, h in sizes}


def _with(values: Iterable[Any], default: Any) -> list[Any]:
    """``values``, and the default if it is not among them."""
    known = list(values)
    return known if default in known else [default, *known]


def _text(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def session_groups(
    settings: CostSettings, on_step: Callable[[int, int], None], compared: dict[tuple[str, str], Choices] | None = None
) -> list[list[Measured]]:
    """Play every scene with every choice at the smallest size. A variant that several stages have is played once."""
    compared = choices() if compared is None else compared
    size = settings.size_list[0]
    variants = list(dict.fromkeys(variant for of in compared.values() for variant in of.values()))
    plays = [
        Play(settings, scene, size, seed, variant)
        for scene in settings.scene_list
        for seed in range(settings.seeds)
        for variant in variants
    ]
    first = {(play.scene, play.variant.encode): play for play in plays}  # a play for each encoding
    total, done = len(first) + len(plays), 0
    for _ in in_parallel(Play.encoded, list(first.values()), settings.workers):
        on_step(done := done + 1, total)
    results = {}
    for play, result in zip(plays, in_parallel(Play.played, plays, settings.workers), strict=True):
        results[play] = result
        on_step(done := done + 1, total)
    return [
        [_measured(Stage(*about, SIDE, QUALITY, costs=COSTS), *choice, size, results) for choice in of.items()]
        for about, of in compared.items()
    ]


def _measured(stage: Stage, label: str, variant: Variant, size: Size, results: Mapping[Play, Played]) -> Measured:
    one = Measured(stage, label, variant == Variant(), f"{size[0]}x{size[1]}")
    for play, result in results.items():
        if play.variant == variant:
            key = play.scene, play.seed
            one.times_ms[key] = [result.spent_ms]
            one.outcomes |= {(*key, part): outcome for part, outcome in enumerate(result.parts)}
    return one
