"""The page of a reproduction: every table and figure, one self-contained HTML file, and the tables as data."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Sequence
from pathlib import Path

from cags_bench import html
from cags_bench.jsonl import dump, provenance
from cags_bench.reproduce.marking import titles
from cags_bench.reproduce.plan import Plan
from cags_bench.reproduce.section import Plot, Section, Strip
from cags_common.files import writable_folder, write_whole

CLAIMS = "claims.jsonl"


def write_section(out: Path, section: Section) -> None:
    """Write one experiment's table as ``NAME.jsonl`` and ``NAME.csv``. Raises :class:`OutputError`."""
    writable_folder(out)
    lines = [line | provenance() for line in section.lines()]
    write_whole(out / f"{section.name}.jsonl", "".join(dump(line) + "\n" for line in lines).encode())
    table = io.StringIO(newline="")
    writer = csv.writer(table)
    writer.writerow(section.columns)
    writer.writerows(section.rows)
    write_whole(out / f"{section.name}.csv", table.getvalue().encode())


def write_claims(out: Path, sections: Sequence[Section]) -> None:
    """Write what is claimed and what was found, a line a claim, as ``claims.jsonl``; other experiments' lines stay."""
    made = {section.name for section in sections}
    kept = [json.loads(line) for line in _lines_of(out / CLAIMS)]
    lines = [line for line in kept if line["experiment"] not in made]
    lines += [{"experiment": section.name, **one} | provenance() for section in sections for one in section.checks]
    write_whole(out / CLAIMS, "".join(dump(line) + "\n" for line in lines).encode())


def _lines_of(path: Path) -> list[str]:
    return path.read_text(encoding="utf-8").splitlines() if path.exists() else []


def write_page(out: Path, sections: Sequence[Section], plan: Plan) -> None:
    """Write ``index.html`` with all sections."""
    size = "quick" if plan.quick else "whole"
    scenes = ", ".join(f"{name} ({spec})" for spec, name in titles(plan.scenes).items())
    intro = (
        f"<p>The paper's tables and figures, made again ({size} run): {plan.frames} frames at "
        f"{plan.width}x{plan.height}; scenes {html.escape(scenes)}; head motion "
        f"{html.escape(plan.poses)}; network {html.escape(plan.trace)}. Quality comes from virtual time and is the "
        "same every time; speed is of the machine named above.</p>"
    )
    parts = [_summary(sections), intro, *map(_section, sections)]
    write_whole(out / "index.html", html.page("Reproduction", parts).encode())


def _summary(sections: Sequence[Section]) -> str:
    """What is claimed and what was found, a line a claim, and where its table is."""
    claims = [(section, one) for section in sections for one in section.checks]
    if not claims:
        return ""
    held = sum(bool(one["ok"]) for _, one in claims)
    rows = "".join(
        f"<tr><td><span class={'held' if one['ok'] else 'missed'}>{'holds' if one['ok'] else 'does not hold'}</span>"
        f"<td class=words><a href='#{section.name}'>{html.escape(one['name'])}</a>"
        f"<td>{html.escape(one['target'])}<td class=words>{html.escape(html.short(one['value']))}</tr>"
        for section, one in claims
    )
    head = "<tr><th>found<th class=words>claim<th>target<th class=words>measured</tr>"
    return f"<h2 id=summary>{held} of {len(claims)} claims hold</h2><table>{head}{rows}</table>"


def _section(section: Section) -> str:
    parts = [
        f"<h2 id={section.name}>{html.escape(section.title)}</h2>",
        f"<p class=note>{html.escape(section.paper)}</p>",
    ]
    parts += [_plot(plot) for plot in section.plots]
    parts += [_strip(strip) for strip in section.strips]
    if section.rows:
        parts.append(html.table(section.columns, section.rows))
    if section.checks:
        rows = [(c["name"], c["target"], c["value"], "yes" if c["ok"] else "no") for c in section.checks]
        parts.append("<h3>Against the targets</h3>" + html.table(("check", "target", "measured", "met"), rows))
    if section.notes:
        parts.append("<ul>" + "".join(f"<li class=note>{html.escape(note)}</li>" for note in section.notes) + "</ul>")
    return "\n".join(parts)


def _strip(strip: Strip) -> str:
    shown = "".join(
        f"<figure><img alt='{html.escape(p.label)}' src='data:image/jpeg;base64,{p.jpeg}'>"
        f"<figcaption>{html.escape(p.label)}</figcaption></figure>"
        for p in strip.pictures
    )
    return f"<h3>{html.escape(strip.title)}</h3><div class=strip>{shown}</div>"


def _plot(plot: Plot) -> str:
    figure, axes = html.new_figure(9, 3.6)
    for number, curve in enumerate(plot.curves):
        style, first = ("-", "--", ":")[number % 3], number == 0  # equal curves stay apart; the first one is ours
        marker = "." if len(curve.x) < 30 else None
        axes.plot(curve.x, curve.y, style, marker=marker, lw=2.4 if first else 1.4, label=curve.label)
    axes.set_title(plot.title, fontsize=10)
    axes.set_xlabel(plot.x_label)
    axes.set_ylabel(plot.y_label)
    axes.legend(fontsize=7, loc="center left", bbox_to_anchor=(1.01, 0.5))
    return html.picture(figure, plot.title)
