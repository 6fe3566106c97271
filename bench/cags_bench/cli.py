"""``cags-bench``: one subcommand per experiment."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator, Sequence
from types import ModuleType
from typing import Any

from cags_common.cli import EXIT_USAGE, command_parser, run_command
from cags_common.errors import ConfigError

SUBCOMMANDS = {
    "stream": "stream a scene or bundle over a trace in virtual time, score every frame, compare settings",
    "raster": "speed and accuracy of the rasteriser backends, the prototype and other renderers",
    "codec": "rate, distortion and times of the quantisers and of other codecs",
    "motion": "bytes per frame and quality of moving scenes, with motion coded separately and without",
    "predict": "accuracy of pose prediction and coverage of the reference's field of view",
    "align": "time of the client's frame and of the server's references",
    "references": "whole sessions with differences, pictures, the paper's method and no references",
    "network": "sending, rate policies and estimators over every shipped trace; many sessions; soak test",
    "demo": "the demo in real time: frames, regularity and quality, also with a core occupied",
    "scale": "server cost per viewer, and sessions that several servers carry",
    "reproduce": "the paper's tables and figures on this project's scenes and traces",
    "web": "the viewer in a browser: a published folder and the server's stream, over several links",
    "cost": "time and bytes of each step of accuracy",
}
"""Subcommands and their summaries. The code is ``cags_bench.<name>.command``, imported only when needed."""

EXAMPLES = """\
  cags-bench stream --scene procedural --frames 60 --json
  cags-bench stream --help
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point of ``cags-bench``."""
    return run_command("cags-bench", _run, argv)


def _run(argv: Sequence[str]) -> int:
    listing = "subcommands:\n" + "\n".join(f"  {name:<10} {text}" for name, text in SUBCOMMANDS.items())
    if not argv or argv[0].startswith("-"):
        parser = command_parser("cags-bench", "Benchmarks and experiments.\n\n" + listing, EXAMPLES)
        parser.usage = "cags-bench SUBCOMMAND [options]"
        parser.parse_args(argv[:1])
        parser.print_help()
        return EXIT_USAGE
    name = argv[0]
    if name not in SUBCOMMANDS:
        raise ConfigError(f"unknown subcommand {name!r}; known: {', '.join(SUBCOMMANDS)}")
    return _run_subcommand(importlib.import_module(f"cags_bench.{name}.command"), name, argv[1:])


def _run_subcommand(module: ModuleType, name: str, argv: Sequence[str]) -> int:
    parser = command_parser(f"cags-bench {name}", module.SUMMARY, module.EXAMPLES)
    parser.add_argument("--json", action="store_true", help="print JSON lines: one per case, then a summary")
    module.add_arguments(parser)
    arguments = parser.parse_args(argv)
    from cags_bench.jsonl import provenance

    where = {"benchmark": name, **provenance()}  # now, so that results name the code with which a long run began
    lines: Iterator[dict[str, Any]] = (where | line for line in module.run(arguments))
    if arguments.json:
        from cags_bench.jsonl import write_lines

        for _ in write_lines(lines):
            pass
    else:
        from cags_bench.tables import print_lines

        getattr(module, "show", print_lines)(lines, sys.stdout)
    return 0
