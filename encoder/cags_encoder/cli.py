"""``cags-encode``: a scene to a bundle."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from cags_common.cli import command_parser, run_command
from cags_common.settings import add_settings, load_settings
from cags_encoder.settings import EncodeSettings

if TYPE_CHECKING:
    from cags_common.bundle import Manifest

PROG = "cags-encode"

EXAMPLES = """\
  cags-encode procedural:size=60000,frames=60 room.cags    the embedded dynamic room
  cags-encode captures/plant.splat plant.cags              a static capture
  cags-encode frames/ clip.cags --fps 30 --frames 90       a folder of numbered files
  cags-encode clip.ply s3://bucket/clip --json             any fsspec URL; a summary for programs"""


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point."""
    return run_command(PROG, _run, argv)


def _parser() -> argparse.ArgumentParser:
    parser = command_parser(PROG, "Encode a sequence of Gaussian frames into a bundle for streaming.", EXAMPLES)
    parser.add_argument("scene", metavar="SCENE", help="file, folder of numbered files, or procedural[:size=..,..]")
    parser.add_argument("out", metavar="OUT", help="folder or fsspec URL; an older bundle there is replaced")
    parser.add_argument("--json", action="store_true", help="print one JSON object about the bundle to stdout")
    add_settings(parser, EncodeSettings)
    return parser


def _run(argv: Sequence[str]) -> None:
    arguments = _parser().parse_args(argv)
    settings = load_settings(EncodeSettings, arguments)
    # Heavy imports wait until the arguments are known to be good: --help answers at once.
    from cags_encoder.pipeline import encode
    from cags_encoder.progress import progress_bar
    from cags_encoder.scenes import open_scene

    source = open_scene(arguments.scene)
    with progress_bar() as progress:
        manifest = encode(source, settings, arguments.out, progress)
    summary = _summary(arguments.out, manifest)
    if arguments.json:
        json.dump(summary, sys.stdout)
        print()
    else:
        print(
            f"{arguments.out}: {summary['frames']} frames, {summary['lods']} LoDs, "
            f"{summary['bytes_tiles'] / 1e6:.2f} MB of tiles, first frame {summary['bytes_first_frame'] / 1e6:.2f} MB "
            f"({summary['bytes_a_splat']:.2f} bytes a splat)"
        )


def _summary(url: str, manifest: Manifest) -> dict[str, Any]:
    from cags_common.bundle import BundleReader

    with BundleReader.open(url) as reader:
        entries = [reader.frame(index) for index in range(manifest.frames)]
        splats = sum(tile.splats for tile in entries[0].tiles)
        return {
            "out": url,
            "name": manifest.name,
            "frames": manifest.frames,
            "fps": manifest.fps,
            "groups": len(manifest.gof_starts),
            "lods": manifest.lods,
            "codec": manifest.codec,
            "quantiser": manifest.quantiser,
            "sh_degree": manifest.sh_degree,
            "splats_first_frame": splats,
            "splats_sent": sum(tile.splats for entry in entries for tile in entry.tiles),
            "bytes_codebooks": len(reader.codebooks()),
            "bytes_tiles": sum(entry.size_bytes for entry in entries),
            "bytes_first_frame": entries[0].size_bytes,
            "bytes_first_frame_base": sum(tile.lod_bytes[0] for tile in entries[0].tiles),
            "bytes_a_splat": entries[0].size_bytes / max(splats, 1),
            "bytes_source": sum(files.source.size_bytes for files in manifest.gofs),
        }
