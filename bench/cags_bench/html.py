"""Self-contained pages: tables, plots as embedded pictures, and one style for light and dark."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

from cags_bench.jsonl import provenance

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; max-width: 64rem; margin: 2rem auto; padding: 0 1rem;
       color: #222; background: #fff }
table { border-collapse: collapse; margin: .5rem 0; display: block; overflow-x: auto }
td, th { padding: .15rem .7rem; border-bottom: 1px solid #ddd; text-align: right }
td:first-child, th:first-child { text-align: left }
img { max-width: 100% }
.default { font-weight: 600 }
td.words, th.words { text-align: left }
.held { color: #060; font-weight: 600 }
.missed { color: #a00; font-weight: 600 }
.note { color: #666 }
.strip { display: flex; flex-wrap: wrap; gap: .5rem }
figure { margin: 0; flex: 1 1 14rem }
@media (prefers-color-scheme: dark) {
  body { color: #ddd; background: #181818 }
  td, th { border-color: #444 }
  .held { color: #7d7 }
  .missed { color: #f88 }
  img.plot { filter: invert(.9) hue-rotate(180deg) }
}
"""


def page(title: str, body: Iterable[str]) -> str:
    """A complete HTML document without external files; it names the machine and commit of the measurement."""
    where = provenance()
    return (
        "<!doctype html><html lang=en><meta charset=utf-8>"
        "<meta name=viewport content='width=device-width, initial-scale=1'>"
        f"<title>{escape(title)}</title><style>{STYLE}</style><h1>{escape(title)}</h1>"
        f"<p class=note>{escape(where['machine'])}, commit {escape(where['commit'])}.</p>"
        + "\n".join(body)
        + "</html>\n"
    )


def escape(value: Any) -> str:
    """Text escaped for HTML."""
    return html.escape(str(value))


def table(columns: Sequence[str], rows: Iterable[Sequence[Any]], emphasised: Iterable[bool] | None = None) -> str:
    """A table with shortened numbers. ``emphasised`` marks rows."""
    marks = iter(emphasised) if emphasised is not None else None
    head = "".join(f"<th>{escape(column)}</th>" for column in columns)
    lines = []
    for row in rows:
        kind = " class=default" if marks is not None and next(marks) else ""
        lines.append(f"<tr{kind}>" + "".join(f"<td>{escape(short(cell))}</td>" for cell in row) + "</tr>")
    return f"<table><tr>{head}</tr>{''.join(lines)}</table>"


def short(value: Any) -> str:
    """A value as readable text; a missing one is a dash."""
    if value is None or value != value:  # noqa: PLR0124 - NaN is the value that differs from itself
        return "–"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def picture(figure: Figure, alt: str) -> str:
    """A matplotlib figure as an embedded PNG; the figure is closed."""
    from matplotlib import pyplot as plt

    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=100)
    plt.close(figure)
    data = base64.b64encode(buffer.getvalue()).decode("ascii")
    return f"<img class=plot alt='{html.escape(alt, quote=True)}' src='data:image/png;base64,{data}'>"


def new_figure(width: float, height: float) -> tuple[Figure, Any]:
    """A figure with one set of axes, drawn without a screen."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(figsize=(width, height), layout="constrained")
    axes.grid(alpha=0.3)
    return figure, axes
