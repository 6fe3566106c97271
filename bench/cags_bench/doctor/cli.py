"""``cags-doctor``: checks this machine and recommends settings."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from cags_common.cli import EXIT_FAILED, EXIT_OK, command_parser, run_command
from cags_common.errors import ConfigError

if TYPE_CHECKING:
    from cags_bench.doctor.findings import Finding
    from cags_bench.doctor.timings import Timings

PROG = "cags-doctor"

EXAMPLES = """\
  cags-doctor              check the machine, time the stages of a frame, recommend settings
  cags-doctor --quick      check only
  cags-doctor --json       print one JSON object
"""


TABLE_COLUMNS = 70
"""Narrower terminals get plain lines instead of the table, whose columns would be too narrow to read."""


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point of ``cags-doctor``: returns 0 if everything needed is present, otherwise 1."""
    return run_command(PROG, _run, argv)


def _parser() -> argparse.ArgumentParser:
    parser = command_parser(
        PROG, "Check what this machine can do, what is missing, and which settings suit it.", EXAMPLES
    )
    parser.add_argument("--quick", action="store_true", help="leave out the timings")
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of tables")
    parser.add_argument(
        "--threads",
        type=int,
        default=None,
        metavar="N",
        help="threads per render (default: number of cores, at most 4)",
    )
    return parser


def _run(argv: Sequence[str]) -> int:
    arguments = _parser().parse_args(argv)
    if arguments.threads is not None and arguments.threads < 1:
        raise ConfigError(f"threads = {arguments.threads} must be at least 1")
    from cags_bench.bundles import default_cache
    from cags_bench.doctor.findings import Verdict
    from cags_bench.doctor.machine import machine_findings, usable_cores
    from cags_bench.doctor.parts import part_findings

    findings = [*machine_findings(default_cache()), *part_findings()]
    broken = any(finding.verdict is Verdict.MISSING for finding in findings)
    timings = None
    codec = any(finding.verdict is Verdict.MISSING and finding.matter == "H.264" for finding in findings)
    if not arguments.quick and not codec:  # without kernels frames can be drawn too, but slowly
        from cags_bench.doctor.timings import measure

        if sys.stderr.isatty():
            print("timing the stages of a frame ...", file=sys.stderr)
        timings = measure(arguments.threads or min(usable_cores(), 4))
    if arguments.json:
        print(json.dumps(report(findings, timings)))
    else:
        _print(findings, timings)
    return EXIT_FAILED if broken else EXIT_OK


def report(findings: Sequence[Finding], timings: Timings | None) -> dict[str, Any]:
    """Everything as one JSON object."""
    from cags_bench.doctor.findings import Verdict
    from cags_bench.doctor.timings import advise
    from cags_bench.jsonl import provenance

    return {
        "healthy": all(finding.verdict is not Verdict.MISSING for finding in findings),
        "findings": [asdict(finding) for finding in findings],
        "timings": asdict(timings) if timings else None,
        "advice": asdict(advise(timings)) if timings else None,
        **provenance(),
    }


def _print(findings: Sequence[Finding], timings: Timings | None) -> None:
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    from cags_bench.doctor.timings import advise

    console = Console(highlight=False)
    marks = {"ok": "[green]ok[/green]", "note": "[yellow]note[/yellow]", "missing": "[red]MISSING[/red]"}
    table = Table("", "what", "found", "what to do", title="this machine", show_lines=False)
    for finding in findings:
        cells = marks[finding.verdict], finding.matter, escape(finding.found), escape(finding.remedy)
        table.add_row(*cells)
        if console.width < TABLE_COLUMNS:
            console.print(f"{cells[0]} {cells[1]}: {cells[2]}" + (f"; {cells[3]}" if cells[3] else ""), soft_wrap=True)
    if console.width >= TABLE_COLUMNS:
        console.print(table)
    if timings is None:
        return
    console.print(_times(timings))
    advice = advise(timings)
    for command, flags in (("cags-server", advice.server), ("cags-client", advice.client)):
        console.print(f"recommended: [bold]{command} {flags}[/bold]", soft_wrap=True)
    console.print(f"  ({advice.reason})", soft_wrap=True)


def _times(timings: Timings) -> Any:
    from rich.table import Table

    title = f"milliseconds a frame: {timings.splats:,} splats, {timings.backend}, {timings.threads} threads"
    columns = ["picture", "draw", "correct", "reference camera", "together"]
    table = Table(*columns, *(["GPU: draw", "together"] if timings.adapter else []), title=title)
    for size in timings.sizes:
        cells = [size.raster_ms, size.correct_ms, size.own_ms, size.total_ms]
        cells += [ms for ms in (size.gpu_draw_ms, size.gpu_total_ms) if ms is not None]
        table.add_row(f"{size.width}x{size.height}", *(f"{value:.1f}" for value in cells))
    table.caption = (
        f"server: reference {timings.reference_ms:.1f}, the client's view {timings.mirror_ms:.1f}, "
        f"difference and H.264 {timings.encode_ms:.1f}"
    )
    if timings.gpu_reference_ms is not None:
        table.caption += f"; GPU ({timings.adapter}): reference and the client's view {timings.gpu_reference_ms:.1f}"
    return table


if __name__ == "__main__":
    raise SystemExit(main())
