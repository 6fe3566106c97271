"""Tables of a Markdown page, generated from a reproduction's figures.

A table stands between ``<!-- made: NAME -->`` and ``<!-- end -->``; :data:`TABLES` lists the names.
"""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Callable, Sequence
from pathlib import Path

from cags_bench import html
from cags_bench.jsonl import JsonObject
from cags_bench.reproduce.experiments import EXPERIMENTS
from cags_bench.reproduce.marking import titled
from cags_bench.reproduce.methods import METHODS
from cags_bench.reproduce.page import CLAIMS
from cags_common.errors import ConfigError
from cags_common.files import write_whole

_MARKED = re.compile(r"(<!-- made: ([a-z]+) -->\n).*?(<!-- end -->)", re.DOTALL)


def renew(page: Path, figures: Path) -> None:
    """Generate the marked tables of ``page`` from the JSON lines in ``figures``. Raises :class:`ConfigError`."""
    write_whole(page, renewed(page_text(page), figures).encode())


def page_text(page: Path) -> str:
    """The text of a page whose tables are to be generated. Raises :class:`ConfigError` if it cannot be read."""
    try:
        return page.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8"
        raise ConfigError(f"page = {page}: cannot be read ({reason}); give an existing Markdown page") from error


def renewed(text: str, figures: Path) -> str:
    """``text`` with its marked tables generated from ``figures``. Raises :class:`ConfigError` for unknown names."""

    def made(match: re.Match[str]) -> str:
        if match[2] not in TABLES:
            raise ConfigError(f"made: {match[2]} is no table; known: {', '.join(TABLES)}")
        return match[1] + "\n" + titled(TABLES[match[2]](figures)) + "\n" + match[3]

    return _MARKED.sub(made, text)


def summary(figures: Path) -> str:
    """What is claimed in ten lines, each over all checks that it rests on: green, red, or not measured."""
    lines = _lines(figures / CLAIMS)
    rows = []
    for words, experiment, pattern in HEADLINES:
        own = [one for one in lines if one["experiment"] in experiment and re.search(pattern, one["name"])]
        missing = [one["name"].partition(":")[0] for one in own if not one["ok"]]
        state = "open" if not own else "red" if missing else "green"
        found = f"{len(own) - len(missing)} of {len(own)} checks hold" if own else "not measured yet"
        rows.append((state, words, found + (f"; not: {', '.join(missing)}" if missing else "")))
    return _where(lines) + _table(("", "claim", "found"), rows)


HEADLINES: tuple[tuple[str, tuple[str, ...], str], ...] = (
    (
        "ours is ahead of every baseline on every scene, over fixed and fluctuating links",
        ("rivals", "range"),
        "^ahead",
    ),
    ("by 5 dB over LTS-F and V3-A at 30 and 60 Mbps", ("rivals",), "^far ahead"),
    ("as published is ahead of LTS-F at 30 Mbps", ("rivals",), "published.* ahead of"),
    ("each part, the paper's and ours, brings something at 30 Mbps", ("ablations",), "brings something"),
    ("leaving out effects that are not needed saves time and changes no picture", ("ablations",), "only the effects"),
    ("ours is ahead on four kinds of motion, and no two methods show the same", ("generality",), ""),
    ("correction by example is above super-resolution and colours alone", ("motivation",), ""),
    ("SVQ is as good as SPZ and SOG, smaller, and decodes faster", ("svq",), ""),
    ("references cover more of the view than the paper's, for people never trained on", ("precision",), ""),
    ("a run gives the same bytes again, and a quick one takes under 25 minutes", ("determinism", "run"), ""),
)
"""A claim in words, and which checks it rests on: experiments, and a pattern of their names."""


def claims(figures: Path) -> str:
    """Claims and results of the reproduction, green or red."""
    lines = _lines(figures / CLAIMS)
    rows = [("green" if one["ok"] else "red", one["name"], one["target"], html.short(one["value"])) for one in lines]
    return _where(lines) + _table(("", "claim", "target", "found"), rows)


def means(figures: Path) -> str:
    """Mean PSNR over scenes by rate and method."""
    lines = _lines(figures / "fixed.jsonl")
    methods = list(dict.fromkeys(line["method"] for line in lines))
    rates = list(dict.fromkeys(line["paper's Mbps"] for line in lines))
    found = {(line["paper's Mbps"], line["method"]): line["PSNR [dB]"] for line in lines}
    rows = []
    for rate in rates:
        best = max(found[rate, method] for method in methods)
        cells = [f"{found[rate, method]:.1f}" for method in methods]
        marked = [f"**{c}**" if found[rate, m] == best else c for c, m in zip(cells, methods, strict=True)]
        rows.append((f"{rate:g}", *marked))
    return _where(lines) + _table(("Mbps of the paper", *methods), rows)


def leads(figures: Path) -> str:
    """Our lead over the baselines, by scene and link, with 95 % intervals."""
    titles = {METHODS[name].title: name for name in BESIDE}
    lines = [line for line in _lines(figures / "rivals.jsonl") if line["method"] == METHODS["cags"].title]
    found: dict[tuple[str, str], dict[str, str]] = {}
    for line in lines:
        if line["baseline"] in titles:
            cell = f"{line['lead']:+.1f} ({_figure(line['95 % from'])} to {_figure(line['to'])})"
            found.setdefault((line["scene"], line["link"]), {})[line["baseline"]] = cell
    titles = {title: name for title, name in titles.items() if any(title in cells for cells in found.values())}
    rows = [(*at, *(cells.get(title, "-") for title in titles)) for at, cells in found.items()]
    return _where(lines) + _table(("scene", "link", *titles), rows)


def _figure(value: float | None, decimals: int = 1) -> str:
    """A bound with ``decimals``. Bounds that are not finite, as for very short plays, are null in JSON."""
    return "unknown" if value is None else f"{value:.{decimals}f}"


def _where(lines: Sequence[JsonObject]) -> str:
    """The machine and the commit of figures."""
    return f"{lines[0]['machine']}, commit {lines[0]['commit']}:\n\n"


def _lines(path: Path) -> list[JsonObject]:
    try:
        found = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    except (OSError, ValueError) as error:
        raise ConfigError(f"{path}: {error}; run cags-bench reproduce --all first") from error
    if not found:
        raise ConfigError(f"{path}: holds no line; run cags-bench reproduce --all first")
    return found


def _table(head: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "".join("| " + " | ".join(str(cell).replace("|", "/") for cell in line) + " |\n" for line in lines)


def full(figures: Path) -> str:
    """The full-size sessions played so far, from the folder ``full``: a row a scene and link, a column a method."""
    lines = _lines(figures / "full" / "sessions.jsonl")
    methods = list(dict.fromkeys(line["method"] for line in lines))
    found = {(line["scene"], line["link"], line["method"]): line for line in lines}
    rows = [
        (scene, link, *(_played(found.get((scene, link, method))) for method in methods))
        for scene in dict.fromkeys(line["scene"] for line in lines)
        for link in dict.fromkeys(line["link"] for line in lines)
        if any((scene, link, method) in found for method in methods)
    ]
    return _where(lines) + _table(("scene", "link", *methods), rows)


def _played(line: JsonObject | None) -> str:
    """PSNR of a session with its interval, the 5th percentile, and what it used of the link."""
    if line is None:
        return ""
    mean = f"{line['PSNR [dB]']:.1f} ({_figure(line['95 % from'])} to {_figure(line['to'])})"
    return f"{mean}, {line['PSNR, 5th percentile']:.1f}, {line['goodput here [Mbps]']:.1f}"


def effects(figures: Path) -> str:
    """What each part brings at 30 Mbps, by scene, and what it costs over all of them."""
    if not (figures / "ablations.jsonl").exists():
        return _unmeasured("ablations")
    lines = [line for line in _lines(figures / "ablations.jsonl") if line["link"] == "30 Mbps"]
    scenes = list(dict.fromkeys(line["scene"] for line in lines))
    rows = []
    for part, of in dict.fromkeys((line["part"], line["of"]) for line in lines):
        own = {line["scene"]: line for line in lines if (line["part"], line["of"]) == (part, of)}
        gains = [
            f"{one['brings [dB]']:+.2f} ({_figure(one['95 % from'], 2)} to {_figure(one['to'], 2)})"
            for one in (own[scene] for scene in scenes)
        ]
        costs = [html.short(own[EVERY].get(name)) for name in COSTS]
        rows.append((part, of, *gains, *costs))
    head = ("effect", "of", *(f"{scene}, dB" for scene in scenes), *COSTS)
    return _where(lines) + _table(head, rows)


EVERY = "all scenes"
COSTS = ("server [ms a frame]", "client [ms a frame]", "kB a frame")


def measured(name: str) -> Callable[[Path], str]:
    """Generator of a whole table as measured, or of how to measure it."""

    def made(figures: Path) -> str:
        path = figures / f"{name}.csv"
        if not path.exists():
            return _unmeasured(name)
        with path.open(newline="", encoding="utf-8") as file:
            head, *rows = csv.reader(file)
        shown = [[_number(cell) for cell in row] for row in rows]
        return _where(_lines(figures / f"{name}.jsonl")) + _table(head, shown)

    return made


def _unmeasured(name: str) -> str:
    return f"Not measured yet: `cags-bench reproduce --{EXPERIMENTS[name].kind} {name}`.\n"


def _number(cell: str) -> str:
    """A cell of a CSV file, shortened if it is a number."""
    try:
        return html.short(float(cell)) if "." in cell else cell or "-"
    except ValueError:
        return cell


BESIDE = ("cags-paper", "lts-f", "v3-a", "v3-a-predicted", "reference-only")
"""Baselines shown by :func:`leads`; the page of figures shows all."""

TABLES: dict[str, Callable[[Path], str]] = {
    "summary": summary,
    "claims": claims,
    "means": means,
    "leads": leads,
    "effects": effects,
    **{name: measured(name) for name in ("range", "generality", "svq", "motivation", "precision")},
    "full": full,
}
"""Generators of the tables, by name."""
