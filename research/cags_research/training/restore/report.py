"""What a training leaves behind for people: curves and a page of facts."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from cags_research.training.restore.trainer import Progress


def write_report(folder: Path, history: Sequence[Progress], about: Mapping[str, Any]) -> Path:
    """Write ``curves.png`` and ``report.md`` into ``folder``; returns the page's path."""
    _curves(history).savefig(folder / "curves.png", dpi=110)
    rows = [
        f"| {p.step} | {p.loss:.3f} | {p.gain_db:+.2f} | {p.lowest_gain_db:+.2f} | {p.worst_gain_db:+.2f} |"
        for p in history
    ]
    page = folder / "report.md"
    page.write_text(
        "\n".join(
            [
                f"# Training of `{about['network']}`",
                "",
                "```json",
                json.dumps(about, indent=2, sort_keys=True),
                "```",
                "",
                "![curves](curves.png)",
                "",
                "Gains are over the distorted picture on held-out scenes, covered pixels; the top is the tenth of the",
                "crops where the distorted picture is best already (no gain is expected, a loss would be bad).",
                "",
                "| step | loss | gain, dB | gain at the top, dB | worst crop, dB |",
                "|---|---|---|---|---|",
                *rows,
                "",
            ]
        ),
        encoding="utf-8",
    )
    return page


def _curves(history: Sequence[Progress]) -> Any:
    from matplotlib.figure import Figure  # without pyplot: no state, no display

    figure = Figure(figsize=(9, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    steps = [p.step for p in history]
    left.plot(steps, [p.loss for p in history], color="C0")
    left.set(xlabel="step", ylabel="loss (mean log squared error)", title="training scenes")
    right.plot(steps, [p.gain_db for p in history], color="C1", label="all crops")
    right.plot(steps, [p.lowest_gain_db for p in history], color="C2", label="best tenth before")
    right.axhline(0, color="0.6", linewidth=0.8)
    right.set(xlabel="step", ylabel="gain over distorted, dB", title="held-out scenes")
    right.legend(frameon=False)
    return figure
