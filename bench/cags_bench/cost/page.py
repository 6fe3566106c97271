"""The page of ``cags-bench cost``: one self-contained HTML file, and the points as JSON lines and CSV."""

from __future__ import annotations

import base64
import csv
import html
import io
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from cags_bench.cost.command import CostSettings
from cags_bench.cost.engine import Measured, marginal_ms_per_db, pareto
from cags_bench.jsonl import dump, provenance

STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem;
       color: #222; background: #fff }
table { border-collapse: collapse; margin: .5rem 0 }
td, th { padding: .15rem .7rem; border-bottom: 1px solid #ddd; text-align: right }
td:first-child, th:first-child { text-align: left }
.default { font-weight: 600 }
.note { color: #666 }
@media (prefers-color-scheme: dark) {
  body { color: #ddd; background: #181818 }
  td, th { border-color: #444 }
  img { filter: invert(.9) hue-rotate(180deg) }
}
"""


def write_page(out: Path, by_stage: Sequence[Sequence[Measured]], settings: CostSettings) -> None:
    """Write ``index.html``, ``points.jsonl`` and ``points.csv`` to ``out``."""
    out.mkdir(parents=True, exist_ok=True)
    lines = [one.line() for group in by_stage for one in group]
    (out / "points.jsonl").write_text("".join(dump(line) + "\n" for line in lines), encoding="utf-8")
    _write_csv(out / "points.csv", lines)
    where = provenance()
    body = [
        "<h1>What accuracy costs</h1>",
        f"<p class=note>Scene {html.escape(settings.scene)}, {settings.width}x{settings.height}. "
        f"{html.escape(where['machine'])}, commit {html.escape(where['commit'])}. One interleaved run; the median of "
        "each point's repetitions. Bold: what the product ships. Circles are on the Pareto front.</p>",
        *(_section(group) for group in by_stage),
    ]
    head = (
        "<!doctype html><meta charset=utf-8><meta name=viewport content='width=device-width'>"
        f"<title>What accuracy costs</title><style>{STYLE}</style>"
    )
    (out / "index.html").write_text(head + "\n".join(body), encoding="utf-8")


def _section(group: Sequence[Measured]) -> str:
    stage = group[0].stage
    rows = "".join(_row(one) for one in group)
    keys = "".join(f"<th>{html.escape(key)}</th>" for key in group[0].outcome)
    costs = "".join(
        f"<li>{html.escape(a)} to {html.escape(b)}: one more dB costs {ms:.2f} ms</li>"
        for a, b, ms in marginal_ms_per_db(pareto(group))
    )
    return (
        f"<h2>{html.escape(stage.name)} <span class=note>({stage.side}; {html.escape(stage.knob)})</span></h2>"
        f"<img alt='time against {html.escape(stage.quality)}' src='data:image/png;base64,{_plot(group)}'>"
        f"<table><tr><th>point</th><th>ms</th><th>&plusmn;</th>{keys}</tr>{rows}</table><ul>{costs}</ul>"
    )


def _row(one: Measured) -> str:
    cells = "".join(f"<td>{value:.4g}</td>" for value in one.outcome.values())
    kind = " class=default" if one.point.default else ""
    label = html.escape(one.point.label)
    return f"<tr{kind}><td>{label}</td><td>{one.median_ms:.3g}</td><td>{one.spread_ms:.2g}</td>{cells}</tr>"


def _plot(group: Sequence[Measured]) -> str:
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    key = group[0].stage.quality
    figure, axes = plt.subplots(figsize=(6.4, 3), layout="constrained")
    front = pareto(group)
    axes.plot(
        [one.median_ms for one in front], [one.outcome[key] for one in front], "-o", color="tab:blue", ms=9, mfc="none"
    )
    for one in group:
        axes.plot(one.median_ms, one.outcome[key], "*" if one.point.default else ".", color="tab:red", ms=11)
        axes.annotate(
            one.point.label, (one.median_ms, one.outcome[key]), fontsize=7, xytext=(4, 4), textcoords="offset points"
        )
    axes.set_xlabel("ms")
    axes.set_ylabel(key)
    axes.grid(alpha=0.3)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=100)
    plt.close(figure)
    return base64.b64encode(buffer.getvalue()).decode("ascii")


def _write_csv(path: Path, lines: Iterable[dict[str, Any]]) -> None:
    lines = list(lines)
    columns = list(dict.fromkeys(key for line in lines for key in line))
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, columns)
        writer.writeheader()
        writer.writerows(lines)
