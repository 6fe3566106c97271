"""Prints plays and comparisons as tables, one row per play."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import IO, TYPE_CHECKING, Any

from cags_bench.stream.figures import FIGURES, GROUPS, PICTURE, Figure

if TYPE_CHECKING:
    from rich.table import Table

WIDTH = 100
"""Line width of text that is not written to a terminal."""


def print_plays(lines: Iterable[dict[str, Any]], stream: IO[str]) -> None:
    """Print a line as soon as each play is complete, then the tables."""
    plays: list[dict[str, Any]] = []
    last: dict[str, Any] = {}
    for line in lines:
        last = line
        if not line.get("summary") or ("compare" not in line and "seeds" not in line):
            plays.append(line)
        if not line.get("summary"):
            print(f"played {_row(line)}", file=stream, flush=True)
    from rich.console import Console  # late import: only needed here

    console = Console(file=stream, highlight=False, width=None if stream.isatty() else WIDTH)
    console.print(_heading(last), markup=False, soft_wrap=True)
    for title, figures in GROUPS.items():
        known = [figure for figure in figures if any(figure.of(play) is not None for play in plays)]
        against = f", compared with {last['truth']}" if title == PICTURE and "truth" in last else ""
        _print_group(console, title + against, known, plays)
    if "compare" in last:
        _print_comparison(console, last)
    for note in _notes(last):
        console.print(note, markup=False, soft_wrap=True)
    console.print(f"{last.get('machine', '')}, commit {last.get('commit', '')}", style="dim", markup=False)


def _row(line: Mapping[str, Any]) -> str:
    words = [str(line["case"])] if line.get("case") else []
    return ", ".join([*words, f"seed {line.get('seed', 0)}"])


def _heading(line: Mapping[str, Any]) -> str:
    settings = line["settings"]
    client = settings["client"]
    share = "" if settings["share"] == 1.0 else f" at {100 * settings['share']:g} % of its rate"
    size = f"{client['width']}x{client['height']}"
    return f"{settings['scene']} over {settings['trace']}{share}, {settings['poses']}, {size}"


def _table(title: str) -> Table:
    from rich import box
    from rich.table import Table

    return Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0))


def _print_group(console: Any, title: str, figures: Sequence[Figure], plays: Sequence[Mapping[str, Any]]) -> None:
    from rich.markup import escape

    table = _table(title)
    table.add_column("play", no_wrap=True)
    for figure in figures:
        table.add_column(escape(f"{figure.title}\n{figure.unit}"), justify="right", no_wrap=True)
    for play in plays:
        table.add_row(escape(_row(play)), *(figure.shown(play) for figure in figures))
    console.print(table)


def _print_comparison(console: Any, line: Mapping[str, Any]) -> None:
    from rich.markup import escape

    first, second = line["compare"]["values"]
    title = f"{second} minus {first}: mean over {line['compare']['seeds']} seeds, 95 % interval of paired differences"
    table = _table(title)
    table.add_column("figure", no_wrap=True)
    for name in (first, second, "difference"):
        table.add_column(escape(name), justify="right", no_wrap=True)
    table.add_column(escape(f"{second} is"), no_wrap=True)
    for figure in FIGURES:
        found = line["figures"].get(figure.key)
        if found is not None:
            means = [figure.text(found["means"][state]) for state in (first, second)]
            table.add_row(escape(figure.name), *means, _interval(figure, found["difference"]), found["verdict"])
    console.print(table)


def _interval(figure: Figure, found: Mapping[str, float]) -> str:
    mean, low, high = (figure.text(found[key]) for key in ("mean", "low", "high"))
    return rf"{mean} \[{low}, {high}]"


def _notes(line: Mapping[str, Any]) -> list[str]:
    by_remedy: dict[str, list[str]] = {}
    for metric, remedy in (line.get("left_out") or {}).items():
        by_remedy.setdefault(remedy, []).append(metric)
    return [f"{', '.join(metrics)} not measured: {remedy}" for remedy, metrics in by_remedy.items()]
