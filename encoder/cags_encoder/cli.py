"""``cags-encode``: encodes scenes into bundles, and inspects, checks, exports and publishes bundles."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

from cags_common.cli import command_parser, run_command
from cags_common.errors import BundleError, ConfigError, DecodeError
from cags_common.settings import add_settings, given_flags, load_settings
from cags_common.words import counted
from cags_encoder.settings import CommandSettings

PROG = "cags-encode"

EXAMPLES = """\
  cags-encode procedural:size=60000,frames=60 room.cags    the embedded dynamic room
  cags-encode captures/plant.splat plant.cags              a static capture
  cags-encode frames/ clip.cags --fps 30 --frames 90       a folder of numbered files
  cags-encode fourd:frames=100,shuffle=1 clip.cags         a generated 4D clip, without identities
  cags-encode clip.ply s3://bucket/clip --json             any fsspec URL; a summary for programs
  cags-encode frames/ clip.cags --scheduler tcp://10.0.0.5:8786    on the workers of a dask cluster
  cags-encode --inspect clip.cags --plot clip.png          frames, quality levels, codebooks, quality
  cags-encode --verify s3://bucket/clip                    check every CRC and decode everything
  cags-encode --export clip.cags 12:5 frame12.ply          frame 12 at LoD 5, for other viewers
  cags-encode clip.ply clip.cags --view view.json          title, background and first view, as the page saves them
  cags-encode --set-view clip.cags view.json               the same for an existing bundle
  cags-encode --publish clip.cags site/                    page and bundle for any web host"""


OTHER_COMMANDS = ("inspect", "verify", "export", "set_view", "publish")
"""Flags that do something other than encode."""


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point."""
    return run_command(PROG, _run, argv)


def _parser() -> argparse.ArgumentParser:
    parser = command_parser(PROG, "Encode a sequence of Gaussian frames into a bundle for streaming.", EXAMPLES)
    parser.add_argument(
        "scene",
        metavar="SCENE",
        nargs="?",
        help="scene: a file, a folder of numbered files, motion:PATH, procedural[:size=..,..] or fourd[:splats=..,..]; "
        "each takes the options shuffle=1 and quantise=sog|spz",
    )
    parser.add_argument(
        "out", metavar="OUT", nargs="?", help="bundle to write: a folder or an fsspec URL; replaced if it exists"
    )
    parser.add_argument("--json", action="store_true", help="print the summary as one JSON object")
    commands = parser.add_mutually_exclusive_group()
    commands.add_argument(
        "--inspect", metavar="BUNDLE", help="describe a bundle: frames, quality layers, codebooks, bytes"
    )
    commands.add_argument(
        "--verify", metavar="BUNDLE", help="check every CRC and decode everything; exits with 1 if anything is damaged"
    )
    commands.add_argument(
        "--export",
        nargs=3,
        metavar=("BUNDLE", "FRAME[:LOD]", "FILE"),
        help="write one frame, at a quality level, as .ply, .compressed.ply, .spz, .sog or .splat",
    )
    commands.add_argument(
        "--set-view",
        nargs=2,
        metavar=("BUNDLE", "FILE"),
        help="store the author's view from a JSON file in a bundle, and a thumbnail of it, without encoding again",
    )
    commands.add_argument(
        "--publish",
        nargs=2,
        metavar=("BUNDLE", "FOLDER"),
        help="write the bundle and the page that plays it to a new folder, for any web host that serves byte ranges",
    )
    parser.add_argument("--plot", metavar="FILE", help="with --inspect: also save a plot, as .png, .svg or .pdf")
    add_settings(parser, CommandSettings)
    return parser


def _run(argv: Sequence[str]) -> None:
    arguments = _parser().parse_intermixed_args(argv)  # so that OUT may come after flags
    names = [name for name in OTHER_COMMANDS if getattr(arguments, name)]
    if arguments.plot and not arguments.inspect:
        raise ConfigError("--plot draws the results of --inspect; add --inspect BUNDLE")
    if names and (arguments.scene or arguments.out):
        raise ConfigError(f"{arguments.scene!r}: --{names[0].replace('_', '-')} takes no SCENE or OUT")
    if names and (given := given_flags(arguments, CommandSettings)):
        raise ConfigError(f"--{given[0]} is an option of encoding; leave it out with --{names[0].replace('_', '-')}")
    if arguments.inspect:
        _inspect(arguments.inspect, arguments.plot, as_json=arguments.json)
    elif arguments.verify:
        _verify(arguments.verify, as_json=arguments.json)
    elif arguments.export:
        _export(*arguments.export, as_json=arguments.json)
    elif arguments.set_view:
        _set_view(*arguments.set_view, as_json=arguments.json)
    elif arguments.publish:
        _publish(*arguments.publish, as_json=arguments.json)
    else:
        _encode(arguments)


def _encode(arguments: argparse.Namespace) -> None:
    if not arguments.scene or not arguments.out:
        raise ConfigError("SCENE and OUT are needed; cags-encode --help shows examples")
    settings = load_settings(CommandSettings, arguments)
    _check_scene(arguments.scene)
    # Heavy imports come after the arguments are checked, so that --help answers at once.
    from cags_common.bundle import BundleReader
    from cags_encoder.bundles.describe import summarise
    from cags_encoder.cache import content_key, resume_folder
    from cags_encoder.execution.executors import open_workers
    from cags_encoder.execution.progress import progress_bar
    from cags_encoder.pipeline import Resume, encode
    from cags_encoder.scenes import open_scene

    source, out = open_scene(arguments.scene), arguments.out
    resume = None
    if settings.resume:
        key = content_key(arguments.scene, settings.encoding)
        resume = Resume(resume_folder(out, key), key)
    with open_workers(settings.workers, settings.scheduler) as workers, progress_bar(lines=True) as progress:
        encode(source, settings.encoding, out, progress, workers=workers, resume=resume)
    with _naming(out), BundleReader.open(out) as reader:
        found = summarise(reader, out)
    pruned = found["pruning"]
    frames, lods = counted(found["frames"], "frame"), counted(found["lods"], "LoD")
    text = (
        f"{out}: {frames}, {lods}, {found['bytes_tiles'] / 1e3:,.1f} kB of tiles, "
        f"first frame {found['bytes_first_frame'] / 1e3:,.1f} kB ({found['bytes_a_splat']:.2f} bytes a splat)"
    )
    if pruned:
        text += f"; pruned to {pruned['splats_after']} splats, {pruned['psnr_db']:.2f} dB relative to all splats"
    _say(found, text, as_json=arguments.json)


def _check_scene(scene: str) -> None:
    """Raise :class:`ConfigError` for what is elsewhere."""
    from cags_encoder.scenes.files import exists

    if "://" in scene and not exists(Path(scene)):
        raise ConfigError(f"SCENE {scene}: is not on this machine; copy it here, only bundles are read from elsewhere")


def _inspect(url: str, picture: str | None, *, as_json: bool) -> None:
    from cags_common.bundle import BundleReader
    from cags_encoder.bundles.describe import describe, lines
    from cags_encoder.bundles.plot import plot

    with _naming(url), BundleReader.open(url) as reader:
        found = describe(reader, url)
    if picture:
        plot(found, Path(picture))
    _say(found, "\n".join(lines(found)), as_json=as_json)


def _verify(url: str, *, as_json: bool) -> None:
    from cags_common.bundle import BundleReader
    from cags_encoder.bundles.verify import verify
    from cags_encoder.execution.progress import progress_bar

    with _naming(url), BundleReader.open(url) as reader, progress_bar(lines=True) as progress:
        payloads = verify(reader, url, lambda done, total: progress("verify", done, total))
        frames = reader.manifest.frames
    found = {"bundle": url, "whole": True, "frames": frames, "payloads": payloads}
    _say(
        found, f"{url}: intact: {counted(frames, 'frame')}, {payloads} payloads with valid CRC decoded", as_json=as_json
    )


def _export(url: str, place: str, file: str, *, as_json: bool) -> None:
    from cags_encoder.bundles.export import export

    with _naming(url):
        splats, name = export(url, place, Path(file))
    found = {"bundle": url, "place": place, "file": file, "format": name, "splats": splats}
    _say(found, f"{file}: {splats} splats as {name}", as_json=as_json)


def _set_view(url: str, file: str, *, as_json: bool) -> None:
    from cags_common.bundle.view import read_view
    from cags_encoder.bundles.author import set_view

    view = read_view(file)
    with _naming(url):
        set_view(url, view)
    _say({"bundle": url, "view": view.table()}, f"{url}: view of {file} stored", as_json=as_json)


def _publish(url: str, folder: str, *, as_json: bool) -> None:
    from cags_encoder.bundles.publish import built_page, publish

    with _naming(url):
        written = publish(url, Path(folder), built_page())
    text = (
        f"{folder}: {written.files} files, {written.bytes / 1e6:.1f} MB; upload them to any web host that serves ranges"
    )
    if not written.page:
        text += "; without the viewer's page, which is not built on this machine"
    _say(asdict(written), text, as_json=as_json)


@contextmanager
def _naming(url: str) -> Iterator[None]:
    """Errors of what a bundle holds name the bundle."""
    try:
        yield
    except (BundleError, DecodeError) as error:
        if str(error).startswith(url):
            raise
        raise type(error)(f"{url}: {error}") from error


def _say(found: dict[str, Any], text: str, *, as_json: bool) -> None:
    if as_json:
        json.dump(found, sys.stdout)
        print()
    else:
        print(text)
