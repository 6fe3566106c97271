"""Tables of a Markdown page, generated from a reproduction's figures.

A table stands between ``<!-- made: NAME -->`` and ``<!-- end -->``; :data:`TABLES` lists the names.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Sequence
from pathlib import Path

from cags_bench import html
from cags_bench.jsonl import JsonObject
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
        return match[1] + "\n" + TABLES[match[2]](figures) + "\n" + match[3]

    return _MARKED.sub(made, text)


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


def _figure(value: float | None) -> str:
    """A bound with one decimal. Bounds that are not finite, as for very short plays, are null in JSON."""
    return "unknown" if value is None else f"{value:.1f}"


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
    """The full-size sessions played so far, from the folder ``full``."""
    lines = _lines(figures / "full" / "sessions.jsonl")
    head = ("scene", "link", "method", "frames", "PSNR, dB (95 %)", "5th percentile", "SSIM", "processor s")
    rows = [
        (
            *(line[name] for name in ("scene", "link", "method", "frames")),
            f"{line['PSNR [dB]']:.1f} ({_figure(line['95 % from'])} to {_figure(line['to'])})",
            f"{line['PSNR, 5th percentile']:.1f}",
            f"{line['SSIM']:.4f}",
            f"{line['processor [s]']:.0f}",
        )
        for line in lines
    ]
    return _where(lines) + _table(head, rows)


BESIDE = ("cags-paper", "lts-f", "v3-a", "v3-a-predicted", "reference-only")
"""Baselines shown by :func:`leads`; the page of figures shows all."""

TABLES: dict[str, Callable[[Path], str]] = {"claims": claims, "means": means, "leads": leads, "full": full}
"""Generators of the tables, by name."""
