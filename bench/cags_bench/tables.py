"""Prints benchmarks as tables, with the same lines as ``--json``. Printing libraries are loaded when needed."""

from __future__ import annotations

from collections.abc import Iterable
from typing import IO, TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.table import Table

HIDDEN = ("machine", "commit", "python", "versions", "checks", "summary", "benchmark", "settings")


def print_lines(lines: Iterable[dict[str, Any]], stream: IO[str]) -> None:
    """Print cases as they come, then the summary and its checks."""
    for line in lines:
        _print_line(line, stream)


def _print_line(line: dict[str, Any], stream: IO[str]) -> None:
    from rich.console import Console

    console = Console(file=stream, highlight=False)
    if not line.get("summary"):
        text = "  ".join(f"{key}={_short(value)}" for key, value in line.items() if key not in HIDDEN)
        console.print(text, markup=False, soft_wrap=True)
        return
    console.print(summary_table(line))
    if line.get("checks"):
        console.print(checks_table(line["checks"]))
    console.print(f"{line.get('machine', '')}, commit {line.get('commit', '')}", style="dim", markup=False)


def summary_table(line: dict[str, Any]) -> Table:
    """The figures of a summary line, one per row."""
    from rich.markup import escape
    from rich.table import Table

    table = Table(title=str(line.get("benchmark", "summary")), show_header=False)
    for key, value in line.items():
        if key not in HIDDEN:
            table.add_row(escape(key), escape(_short(value)))
    return table


def checks_table(checks: Iterable[dict[str, Any]]) -> Table:
    """Targets and measured values."""
    from rich.markup import escape
    from rich.table import Table

    table = Table("check", "target", "measured", "met", title="checks")
    for row in checks:
        cells = str(row["name"]), str(row["target"]), _short(row["value"]), "yes" if row["ok"] else "NO"
        table.add_row(*map(escape, cells))
    return table


def _short(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.4g}" if abs(value) < 1000 else f"{value:,.0f}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_short, value))}]"
    if isinstance(value, dict):
        return ", ".join(f"{key}: {_short(item)}" for key, item in value.items())
    return str(value)
