"""``cags-demo [SCENE]``: encode, serve, shape, watch, report."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from cags_bench.demo.settings import DemoSettings
from cags_common.cli import command_parser, run_command
from cags_common.errors import ConfigError
from cags_common.settings import add_settings, load_settings

EXAMPLES = """\
  cags-demo                                  the built-in scene over a generated LTE trace
  cags-demo --view                           watch the stream live in a browser
  cags-demo scene_folder --trace link.csv    your own numbered frames over your own trace
  cags-demo motion:plant.splat --out report  a static capture with added motion
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point of ``cags-demo``."""
    return run_command("cags-demo", _run, argv)


def _run(argv: Sequence[str]) -> int:
    parser = command_parser(
        "cags-demo",
        "Stream a scene through server, shaper and client on this machine, and write a report of what was shown.",
        EXAMPLES,
    )
    parser.add_argument(
        "scene",
        nargs="?",
        default="procedural",
        help="file, folder, bundle, motion:PATH, procedural[:size=N,...] or fourd[:..]",
    )
    parser.add_argument("--json", action="store_true", help="print the summary as one JSON line instead of a table")
    add_settings(parser, DemoSettings)
    arguments = parser.parse_args(argv)
    settings = load_settings(DemoSettings, arguments)

    if settings.view and arguments.json:
        raise ConfigError("--json prints the summary of a finished play; leave --view out")
    from cags_bench.demo.run import run_demo, show_live

    if settings.view:
        show_live(arguments.scene, settings, progress=sys.stderr)
        return 0
    summary = run_demo(arguments.scene, settings, progress=sys.stderr)
    if arguments.json:
        from cags_bench.jsonl import dump

        print(dump(summary))
    else:
        _print_summary(summary, settings.out)
    return 0


def _print_summary(summary: dict[str, Any], out: str) -> None:
    """Print a summary in words, and the paths of the report's files."""
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    from cags_client.output.summary import summary_rows

    table = Table(show_header=False, box=None, pad_edge=False)
    rate = f"{100 * summary['share']:g} % of its rate"
    rows = [
        ("link", f"{summary['trace']} at {rate}, {summary['delay_ms']:g} ms each way"),
        *summary_rows(summary, summary["clip_frames"]),
        ("pictures", _pictures(summary["strip"], Path(out) / "strip.png")),
        ("over time", f"{Path(out) / 'timeline.png'}; every figure: {Path(out) / 'frames.jsonl'}"),
    ]
    for name, value in rows:
        table.add_row(name, escape(value))
    Console(highlight=False).print(table)


def _pictures(strip: dict[str, Any] | None, path: Path) -> str:
    """What the strip shows."""
    if strip is None:
        return "none: no frame whose pictures are saved was shown"
    frame, gain_db = strip["frame"], strip["gain_db"]
    if gain_db > 0:
        return f"{path}: effect of references on frame {frame}, the saved one that gains most ({gain_db:.1f} dB)"
    why = "references improved none of" if gain_db else "nothing had to be corrected in"
    return f"{path}: frame {frame} beside the truth; {why} the saved frames"


if __name__ == "__main__":
    raise SystemExit(main())
