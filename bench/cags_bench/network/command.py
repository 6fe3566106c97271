"""``cags-bench network``: sending, content, many sessions and soak, in virtual and real time."""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cags_common.errors import ConfigError
from cags_common.settings import add_settings, check_settings, load_settings, setting

if TYPE_CHECKING:
    from cags_bench.sim.session import Scenario

SUMMARY = (
    "Measure the stream on networks: utilisation, latency, competing traffic, quality by trace and policy, many "
    "sessions, a soak test."
)

EXAMPLES = """\
  cags-bench network --json
  cags-bench network --parts sending,crowd --json
  cags-bench network --parts cross --seeds 10 --json
  cags-bench network --parts content --scene procedural:size=6000 --frames 60 --traces generated:steady-30,link.csv
  cags-bench network --parts soak --soak-minutes 1440
"""

PARTS = ("sending", "sockets", "cross", "first", "content", "realtime", "clients", "crowd", "soak")

PLAYS = {"first", "content", "realtime", "clients"}
"""Parts that play a scene."""


@dataclass(frozen=True)
class NetworkSettings:
    """Which parts are run, and for how long."""

    parts: str = setting(",".join(PARTS), f"parts to run, of {', '.join(PARTS)}")
    scene: str = setting("procedural:size=10000,frames=60", "scene of the content, real-time and clients parts")
    like_splats: int = setting(
        170_000,
        "scale the content part's links as if the scene had this many splats (the paper's number); 0: do not",
        low=0,
        high=100_000_000,
    )
    first_scene: str = setting("procedural:size=160000,frames=6", "scene of the first part (time to the first picture)")
    lpips: str = setting("", "weights of LPIPS (.npz) to score the first picture; empty: no LPIPS")
    workers: int = setting(0, "processes of the content and cross parts; 0: one per core", low=0, high=256)
    frames: int = setting(210, "media frames to play", low=2, high=1_000_000)
    poses: str = setting("synthetic:walking", "head motion: a pose file or synthetic:NAME")
    traces: str = setting(
        "", "traces of the content part, comma separated; empty: all generated ones and steady 10 Mbps"
    )
    policies: str = setting("paper,utility,buffer", "rate policies of the content part, comma separated")
    estimator: str = setting("measured", "bandwidth estimator of the content part", choices=("measured", "oracle"))
    restore: str = setting("correct", "use of references: correct, none, or another restorer for comparison")
    width: int = setting(400, "client width in pixels", low=1, high=8192)
    height: int = setting(300, "client height in pixels", low=1, high=8192)
    delay_ms: float = setting(10.0, "one-way propagation delay, ms", low=0, high=1000)
    seconds: float = setting(20.0, "virtual seconds per case of the sending and cross parts", low=5, high=3600)
    seeds: int = setting(5, "plays per cross case; results are means with 95 % intervals", low=1, high=1000)
    starts: int = setting(
        5, "plays per content case with an incident, half a second apart around its start_s", low=1, high=1000
    )
    clients: int = setting(16, "headless clients at one server", low=1, high=1000)
    clients_mbps: float = setting(3.0, "link of each headless client, Mbps; 0: unlimited", low=0, high=1e4)
    sessions: int = setting(1000, "sessions of the crowd", low=1, high=100_000)
    soak_minutes: float = setting(10.0, "virtual minutes of the soak", low=0.1, high=100_000)
    cache: str = setting("", "folder of encoded bundles to reuse; empty: the user's cache folder")

    def __post_init__(self) -> None:
        check_settings(self)
        unknown = [part for part in self.parts.split(",") if part not in PARTS]
        if unknown:
            raise ConfigError(f"parts = {unknown[0]!r} is unknown; known: {', '.join(PARTS)}")

    @property
    def trace_list(self) -> list[str]:
        """Traces of the content part; none: the usual ones."""
        return self.traces.split(",") if self.traces else []


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's flags."""
    add_settings(parser, NetworkSettings)
    parser.add_argument("--plot", metavar="TRACE", help="plot a session's event trace into a PNG beside it, and exit")


def run(arguments: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """Yield one line per case, and the summary with its checks."""
    from cags_bench.jsonl import summary
    from cags_bench.network.checks import checks

    if arguments.plot is not None:
        from cags_bench.network.plot import plot_session

        yield {"plot": str(plot_session(Path(arguments.plot)))}
        return
    settings = load_settings(NetworkSettings, arguments)
    _check(settings)
    lines: list[dict[str, Any]] = []
    for line in _cases(settings):
        lines.append(line)
        yield line
    yield summary("network", checks(lines))


def _check(settings: NetworkSettings) -> None:
    """Refuse wrong inputs before anything is measured. Raises :class:`CagsError`."""
    from cags_bench.inputs import check_scenes, check_traces, check_walks
    from cags_client.frame import restore
    from cags_common.lpips import Lpips
    from cags_server.session.policies import check_choices
    from cags_server.settings import ServerSettings

    parts = set(settings.parts.split(","))
    if parts & PLAYS:
        check_walks([settings.poses])
        restore.check_name(settings.restore)
        if parts & (PLAYS - {"first"}):
            check_scenes([settings.scene])
        if "first" in parts:
            check_scenes([settings.first_scene])
        if settings.lpips:
            Lpips(settings.lpips)
    if "content" in parts:
        check_traces(settings.trace_list)
        for policy in settings.policies.split(","):
            check_choices(ServerSettings(abr=policy))


def _cases(settings: NetworkSettings) -> Iterator[dict[str, Any]]:
    parts, delay_us = settings.parts.split(","), round(settings.delay_ms * 1000)
    if "sending" in parts:
        from cags_bench.network.sending import sending_lines

        yield from sending_lines(round(settings.seconds * 1e6), delay_us)
    if "sockets" in parts:
        from cags_bench.network.sockets import direct_lines, socket_lines

        yield from socket_lines(round(settings.seconds * 1e6), delay_us)
        yield from direct_lines(round(settings.seconds * 1e6), delay_us)
    if "cross" in parts:
        from cags_bench.network.cross.experiment import cross_lines

        yield from cross_lines(round(settings.seconds * 1e6), settings.seeds, settings.workers or os.cpu_count() or 1)
    if "first" in parts:
        yield from _first_pictures(settings)
    if {"content", "realtime", "clients"} & set(parts):
        yield from _plays(settings, parts)
    if "crowd" in parts:
        from cags_bench.network.crowd import crowd_line

        yield crowd_line(settings.sessions, 2_000_000, delay_us)
    if "soak" in parts:
        yield _soak(settings)


def _plays(settings: NetworkSettings, parts: list[str]) -> Iterator[dict[str, Any]]:
    from cags_bench.bundles import cached_bundle
    from cags_bench.network.content import content_lines, scenario
    from cags_bench.network.realtime import realtime_lines
    from cags_bench.network.sending import CLIPS, SLOW
    from cags_encoder import EncodeSettings

    workers = settings.workers or os.cpu_count() or 1
    bundle = cached_bundle(settings.scene, settings.cache, EncodeSettings(frames=settings.frames))
    base: Scenario = scenario(bundle, settings)
    if "content" in parts:
        policies = settings.policies.split(",")
        yield from content_lines(
            settings.trace_list or [SLOW[-1], *CLIPS],
            policies,
            base,
            like_splats=settings.like_splats,
            workers=workers,
            starts=settings.starts,
        )
    if "realtime" in parts:
        yield from realtime_lines(base, settings.like_splats)
    if "clients" in parts:
        from cags_bench.network.clients import clients_line

        yield clients_line(base, settings.clients, settings.clients_mbps or None)


def _first_pictures(settings: NetworkSettings) -> Iterator[dict[str, Any]]:
    from cags_bench.bundles import cached_bundle
    from cags_bench.network.content import first_picture_lines, scenario
    from cags_bench.network.sending import SLOW
    from cags_encoder import EncodeSettings

    bundle = cached_bundle(settings.first_scene, settings.cache, EncodeSettings())
    yield from first_picture_lines(scenario(bundle, settings), SLOW)


def _soak(settings: NetworkSettings) -> dict[str, Any]:
    from cags_bench.network.soak import run_soak
    from cags_shaper.trace import open_trace

    result = run_soak(open_trace("generated:lte-driving"), round(settings.soak_minutes * 60e6))
    counts = {
        name: dict(sorted(value.items())) if isinstance(value, dict) else value for name, value in vars(result).items()
    }
    return {"case": "soak", "virtual_minutes": settings.soak_minutes, **counts}
