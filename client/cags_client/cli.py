"""``cags-client``: watch a stream headless, save it, score it."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cags_common.cli import command_parser, run_command
from cags_common.errors import CagsError, ConfigError
from cags_common.runtime.endings import EXIT_SIGNAL
from cags_common.settings import add_flags, add_settings, given_flags, load_settings

if TYPE_CHECKING:
    from cags_client.output.page.settings import ViewSettings
    from cags_client.output.sinks import FrameSink
    from cags_client.output.spool import ScoringSpool
    from cags_client.settings import ClientSettings
    from cags_common.bundle.manifest import Manifest
    from cags_common.poses import PoseTrace

PROG = "cags-client"
DEFAULT_WALK = "synthetic:walking"
STAGES_EVERY = 30
"""Frames between those whose intermediate pictures are saved."""

EXAMPLES = """\
  cags-client --url ws://127.0.0.1:8765/stream
  cags-client --url ws://a:8765/stream,ws://b:8765/stream          b takes over when a is gone
  cags-client --url ws://127.0.0.1:8765/stream --scene room        one scene of a server with several
  cags-client --url ws://127.0.0.1:8765/stream --view              a page to look at and to steer
  cags-client --url ws://127.0.0.1:8765/stream --poses walk.csv --record clip.mp4
  cags-client --url ws://127.0.0.1:8765/stream --headless --duration 5 --json -
  cags-client --url ws://host:8765/stream --poses synthetic:turning:seed=3 --width 1600 --height 1200 \\
      --truth scene.bundle --json report.jsonl --stages pictures --duration 5
"""


@dataclass(frozen=True)
class _Outputs:
    url: str
    poses: str | None
    record: str | None
    json: str | None
    truth: str | None
    stages: str | None
    stages_every: int
    view: bool
    headless: bool


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit code."""
    return run_command(PROG, _body, argv)


def _parser() -> argparse.ArgumentParser:
    from cags_client.settings import ClientSettings

    parser = command_parser(PROG, "Watch a stream headless: decode, draw, correct, save, score.", EXAMPLES)
    parser.add_argument(
        "--url",
        required=True,
        help="stream address, ws://HOST:PORT/stream; several servers of one scene are separated by commas",
    )
    parser.add_argument(
        "--poses",
        help="head motion: a CSV trace (time_s,px,py,pz,qw,qx,qy,qz), or synthetic:"
        "{still,looking,turning,walking,jitter}[:seed=N] (default: synthetic:walking, from the author's view on, or "
        "from where an object is whole in view)",
    )
    parser.add_argument("--scene", default="", metavar="NAME", help="scene to play, for a server of several")
    parser.add_argument(
        "--record",
        "--save",
        metavar="DIR|FILE.mp4",
        help="write displayed frames, into a new folder as PNG files or as a video",
    )
    parser.add_argument("--headless", action="store_true", help="print no live table, even in a terminal")
    parser.add_argument(
        "--json", metavar="FILE|-", help="write one JSON line per frame and a summary line; - is stdout"
    )
    parser.add_argument("--truth", metavar="BUNDLE", help="score every frame against the source frames of this bundle")
    parser.add_argument("--stages", metavar="DIR", help="folder for the intermediate pictures of some frames")
    parser.add_argument(
        "--stages-every", type=int, metavar="N", help=f"frames between those of --stages (default: {STAGES_EVERY})"
    )
    add_settings(parser, ClientSettings)
    _add_view(parser)
    return parser


def _add_view(parser: argparse.ArgumentParser) -> None:
    from cags_client.output.page.settings import ViewSettings

    page = parser.add_argument_group("live page")
    page.add_argument(
        "--view", action="store_true", help="serve a live page to watch and steer; plays until interrupted"
    )
    add_flags(page, ViewSettings)


def _body(argv: Sequence[str]) -> int | None:
    arguments = _parser().parse_args(argv)
    from cags_client.net.endpoints import of_scene
    from cags_client.output.page.settings import ViewSettings
    from cags_client.settings import ClientSettings

    settings = load_settings(ClientSettings, arguments, ViewSettings)
    names = ("url", "poses", "record", "json", "truth", "stages", "stages_every", "view", "headless")
    if arguments.stages_every is None:
        arguments.stages_every = STAGES_EVERY
    elif not arguments.stages:
        raise ConfigError("--stages-every is an option of --stages; add --stages DIR or leave it out")
    outputs = _Outputs(**{name: getattr(arguments, name) for name in names})
    outputs = replace(outputs, url=of_scene(outputs.url, arguments.scene))
    if outputs.stages_every < 1:
        raise ConfigError(f"stages_every = {outputs.stages_every} must be at least 1")
    settings = replace(settings, raster=_checked_choices(settings, outputs))
    _check_json(outputs.json)
    _check_apart(outputs)
    if outputs.view:
        _check_view(outputs)
        _look(settings, outputs, load_settings(ViewSettings, arguments, ClientSettings))
        return None
    for flag in given_flags(arguments, ViewSettings):
        if flag != "config":
            raise ConfigError(f"--{flag} is a setting of the live page; add --view or leave it out")
    _check_pictures(outputs)
    return _watch(settings, outputs)


def _checked_choices(settings: ClientSettings, outputs: _Outputs) -> str:
    """The rasteriser chosen; what is misspelt is told before any server is asked. Raises :class:`CagsError`."""
    from cags_client.frame import align, restore
    from cags_common import raster
    from cags_common.poses import Focus, open_poses
    from cags_common.runtime.terminal import watched

    def tell(reason: str) -> None:
        if watched(headless=outputs.headless):
            print(f"{PROG}: {reason}", file=sys.stderr)

    rasteriser = raster.chosen(settings.raster, tell)
    raster.create(rasteriser)
    align.create(settings.align)
    restore.check_name(settings.restore)
    open_poses(outputs.poses or DEFAULT_WALK, Focus((0.0, 0.0, 0.0), 1.0, (0.0, 1.0, 0.0)))
    return rasteriser


def _watch(settings: ClientSettings, outputs: _Outputs) -> int | None:
    """Play to the end; returns the exit code. Outputs are written after an interrupt, of the play or of scoring, and
    after an error, too. Raises :class:`CagsError`, at the end if anything was shown before.
    """
    from cags_client.app import close_sinks, run_playback
    from cags_client.interrupts import noted_interrupts
    from cags_client.net.endpoints import fetch_info
    from cags_client.output.report import summary
    from cags_client.output.truth import BundleTruth

    truth = BundleTruth(outputs.truth, settings) if outputs.truth else None
    info = fetch_info(outputs.url, settings.token, settings.ca)
    if truth:
        truth.check(info)
    if settings.start_frame >= info.frames:
        raise ConfigError(f"start_frame = {settings.start_frame} is outside 0 to {info.frames - 1}, the clip's frames")
    poses = _walk(outputs.poses, settings, info)
    sinks, spool = _open_sinks(outputs, info)
    completed = False
    try:
        with _shown_live(info, outputs) as on_frame:
            playback = run_playback(outputs.url, settings, poses, sinks, near=info.near, on_frame=on_frame)
        completed = True
    finally:
        if not completed:
            close_sinks(sinks, completed=False)
    records, after = playback.frames, f"{len(playback.frames)} frames"
    with noted_interrupts() as noted:
        close_sinks(sinks, completed=True)
        if spool is not None and truth is not None:
            scored = _score(records, spool, truth, outputs, noted)
            after += f", {scored} of them scored" if noted else ""
        last = summary(records, playback.player.stats)
        _report(outputs.json, [*records, last], _frames(settings, info))
    if playback.error is not None:
        raise playback.error
    ended_by = playback.ended_by or next(iter(noted), None)
    if ended_by is None:
        return None
    print(f"{PROG}: ended by {ended_by.name} after {after}", file=sys.stderr)
    return EXIT_SIGNAL + ended_by


@contextmanager
def _shown_live(info: Manifest, outputs: _Outputs) -> Iterator[Callable[[dict[str, Any]], None] | None]:
    """Takes the records of frames for a live table, where somebody looks."""
    from cags_common.runtime.terminal import live_table, watched

    if not watched(headless=outputs.headless):
        yield None
        return
    from cags_client.output.console import PlayConsole

    console = PlayConsole(f"{info.name}  {outputs.url}", info.frames)
    with live_table(console.table):
        yield console.add


def _check_view(outputs: _Outputs) -> None:
    for flag in ("record", "stages"):
        if getattr(outputs, flag):
            raise ConfigError(f"--{flag} does not go with --view, which has no end; leave one out")
    from cags_client.output.page.assets import why_missing

    if (reason := why_missing()) is not None:
        raise ConfigError(reason)


def _look(settings: ClientSettings, outputs: _Outputs, view: ViewSettings) -> None:
    """Serve the live page until interrupted."""
    import asyncio

    from cags_client.live_app import watch_live
    from cags_client.net.endpoints import fetch_info
    from cags_client.output.report import summary
    from cags_client.output.truth import BundleTruth

    truth = BundleTruth(outputs.truth, settings) if outputs.truth else None
    info = fetch_info(outputs.url, settings.token, settings.ca)
    if truth:
        truth.check(info)
    walk = _walk(outputs.poses, settings, info)
    with _shown_live(info, outputs) as on_frame:
        playback = asyncio.run(
            watch_live(
                outputs.url,
                settings,
                view,
                info,
                walk=walk,
                sinks=(),
                truth=truth,
                on_ready=_tell_page(outputs.json == "-"),
                on_frame=on_frame,
            )
        )
    if outputs.json:
        _report(outputs.json, [*playback.frames, summary(playback.frames, playback.player.stats)], info.frames)
    if playback.error is not None:
        raise playback.error


def _tell_page(as_json: bool) -> Callable[[str], None]:
    import json

    def tell(url: str) -> None:
        print(json.dumps({"ready": True, "url": url}) if as_json else f"live page: {url}", flush=True)

    return tell


def _walk(poses: str | None, settings: ClientSettings, info: Manifest) -> PoseTrace:
    """The walk that ``poses`` names; where none is named, one that begins at the author's view, or where an object is
    whole in view."""
    from cags_common.bundle.first_view import first_pose
    from cags_common.poses import Focus, open_poses
    from cags_common.poses.place import DISTANCE_IN_RADII

    focus = Focus(info.focus_centre, info.focus_radius, info.up)
    if poses is not None:
        return open_poses(poses, focus, window_us=_window_us(settings, info))
    if info.view is not None and info.view.pose is not None:
        return open_poses(DEFAULT_WALK, focus).beginning_at(info.view.pose)
    pinhole = settings.intrinsics
    pose = first_pose(info, pinhole.width_px / (2 * pinhole.fx_px), pinhole.height_px / (2 * pinhole.fy_px))
    away = math.dist(info.focus_centre, pose.position)
    return open_poses(DEFAULT_WALK, replace(focus, radius=away / DISTANCE_IN_RADII)).beginning_at(pose)


def _window_us(settings: ClientSettings, info: Manifest) -> int:
    return settings.start_delay_ms * 1000 + round(_seconds(settings, info) * 1e6)


def _seconds(settings: ClientSettings, info: Manifest) -> float:
    """Length of the play."""
    clip_s = (info.frames - settings.start_frame) / info.fps
    return clip_s if settings.duration is None else min(clip_s, settings.duration)


def _frames(settings: ClientSettings, info: Manifest) -> int:
    """Media frames of the play, counted as the player does: a very short one still shows a frame."""
    return max(1, round(_seconds(settings, info) * info.fps))


def _open_sinks(outputs: _Outputs, info: Manifest) -> tuple[list[FrameSink], ScoringSpool | None]:
    from cags_client.output.files import StagesSink, open_save
    from cags_client.output.spool import ScoringSpool

    sinks: list[FrameSink] = []
    if outputs.stages:
        sinks.append(StagesSink(Path(outputs.stages), outputs.stages_every))
    spool = ScoringSpool() if outputs.truth else None
    if spool is not None:
        sinks.append(spool)
    if outputs.record:
        sinks.append(open_save(outputs.record, info.fps))
    return sinks, spool


def _score(
    records: list[dict[str, Any]], spool: ScoringSpool, truth: Any, outputs: _Outputs, stop: Sequence[object]
) -> int:
    """Add the scores to the records, until ``stop`` holds anything; returns how many frames were scored."""
    from cags_client.output.files import stage_path, write_png

    progress, scored = _Progress(len(spool)), 0
    by_frame = {record["frame"]: record for record in records}
    for frame, scores, picture in spool.scores(truth):
        by_frame[frame].update(scores)
        if outputs.stages and frame % outputs.stages_every == 0:
            write_png(stage_path(Path(outputs.stages), frame, "truth"), picture)
        progress.step("scoring")
        scored += 1
        if stop:
            break
    progress.end()
    return scored


def _check_json(path: str | None) -> None:
    if not path or path == "-":
        return
    if not Path(path).resolve().parent.is_dir():
        raise CagsError(f"{path}: its folder does not exist; make it first")
    if Path(path).is_dir():
        raise ConfigError(f"--json {path}: is a folder; give a file's name, or - for stdout")


def _check_apart(outputs: _Outputs) -> None:
    """Two outputs of one name would replace each other."""
    of: dict[Path, str] = {}
    for flag in ("record", "json", "stages"):
        path = getattr(outputs, flag)
        if path and (flag, path) != ("json", "-"):
            other = of.setdefault(Path(path).resolve(), flag)
            if other != flag:
                raise ConfigError(f"--{other} and --{flag} both name {path}; give each a name of its own")


def _check_pictures(outputs: _Outputs) -> None:
    from cags_client.output.files import check_picture_folder, check_save

    if outputs.record:
        check_save(outputs.record)
    if outputs.stages:
        check_picture_folder("--stages", Path(outputs.stages))


def _report(path: str | None, records: list[dict[str, Any]], clip_frames: int) -> None:
    """Write the report, or tell people what it comes to."""
    from cags_client.output.report import json_text
    from cags_client.output.summary import summary_rows

    if path == "-":
        sys.stdout.write(json_text(records))
    elif path:
        from cags_common.files import write_whole

        write_whole(Path(path), json_text(records).encode())
    else:
        for name, value in summary_rows(records[-1], clip_frames):
            print(f"{name:12} {value}")


class _Progress:
    """A counter on stderr, where a person looks at it."""

    def __init__(self, total: int) -> None:
        self._total, self._done, self._on = total, 0, sys.stderr.isatty()

    def step(self, what: str) -> None:
        """One more."""
        self._done += 1
        if self._on:
            print(f"\r{what} {self._done}/{self._total}", end="", file=sys.stderr, flush=True)

    def end(self) -> None:
        """Leave the line."""
        if self._on and self._done:
            print(file=sys.stderr)
