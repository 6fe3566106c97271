"""The page of ``cags-bench cost``: one self-contained HTML file, and the points as JSON lines and CSV."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from cags_bench import html
from cags_bench.cost.engine import Measured, marginal_ms_per_db, pareto
from cags_bench.cost.settings import CostSettings
from cags_bench.jsonl import dump


def write_page(out: Path, by_stage: Sequence[Sequence[Measured]], settings: CostSettings) -> None:
    """Write ``index.html``, ``points.jsonl`` and ``points.csv`` to ``out``."""
    out.mkdir(parents=True, exist_ok=True)
    lines = [one.line() for group in by_stage for one in group]
    (out / "points.jsonl").write_text("".join(dump(line) + "\n" for line in lines), encoding="utf-8")
    _write_csv(out / "points.csv", lines)
    intro = (
        f"<p class=note>Scene {html.escape(settings.scene)}, {settings.width}x{settings.height}. One interleaved run; "
        "times are the median of each point's repetitions. Bold and starred: the defaults. Circles: the "
        "Pareto front.</p>"
    )
    body = [intro, *(_section(group) for group in by_stage)]
    (out / "index.html").write_text(html.page("Cost of accuracy", body), encoding="utf-8")


def _section(group: Sequence[Measured]) -> str:
    stage = group[0].stage
    columns = ["point", "ms", "interquartile range [ms]", *group[0].outcome]
    rows = [[one.point.label, one.median_ms, one.spread_ms, *one.outcome.values()] for one in group]
    costs = "".join(
        f"<li>{html.escape(a)} to {html.escape(b)}: {ms:.3g} ms per additional dB</li>"
        for a, b, ms in marginal_ms_per_db(pareto(group))
    )
    return (
        f"<h2>{html.escape(stage.name)} <span class=note>({stage.side}; {html.escape(stage.knob)})</span></h2>"
        + _plot(group)
        + html.table(columns, rows, (one.point.default for one in group))
        + f"<ul>{costs}</ul>"
    )


def _plot(group: Sequence[Measured]) -> str:
    key = group[0].stage.quality
    figure, axes = html.new_figure(6.4, 3)
    front = pareto(group)
    axes.plot([o.median_ms for o in front], [o.outcome[key] for o in front], "-o", color="tab:blue", ms=9, mfc="none")
    for one in group:
        at = (one.median_ms, one.outcome[key])
        axes.plot(*at, "*" if one.point.default else ".", color="tab:red", ms=11)
        axes.annotate(one.point.label, at, fontsize=7, xytext=(4, 4), textcoords="offset points")
    axes.set_xlabel("ms")
    axes.set_ylabel(key)
    return html.picture(figure, f"{key} against time")


def _write_csv(path: Path, lines: Iterable[dict[str, Any]]) -> None:
    lines = list(lines)
    columns = list(dict.fromkeys(key for line in lines for key in line))
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, columns)
        writer.writeheader()
        writer.writerows(lines)
