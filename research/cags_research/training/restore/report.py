"""What a training leaves behind for people: curves and a page of facts."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from cags_research.training.restore.trainer import Progress


def write_report(folder: Path, history: Sequence[Progress], about: Mapping[str, Any]) -> Path:
    """Write ``curves.png``, ``history.jsonl`` and ``report.md`` into ``folder``; returns the page's path."""
    _curves(history).savefig(folder / "curves.png", dpi=110)
    rows = [
        f"| {p.step} | {p.loss:.3f} | {p.gain_db:+.2f} | {_by_level(p)} | {p.worst_gain_db:+.2f} |" for p in history
    ]
    levels = list(history[-1].gains_db)
    (folder / "history.jsonl").write_text("".join(json.dumps(asdict(p)) + "\n" for p in history), encoding="utf-8")
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
                "Gains are over the distorted picture on held-out scenes, covered pixels, by level (the share of the",
                "ladder that all tiles have; at 1 none is expected, a loss would be bad). The last weights are kept.",
                "",
                "| step | loss | gain, dB | " + " | ".join(f"at {level}" for level in levels) + " | worst crop, dB |",
                "|---|---|---|" + "---|" * len(levels) + "---|",
                *rows,
                "",
            ]
        ),
        encoding="utf-8",
    )
    return page


def _by_level(line: Progress) -> str:
    return " | ".join(f"{gain:+.2f}" for gain in line.gains_db.values())


def _curves(history: Sequence[Progress]) -> Any:
    from matplotlib.figure import Figure  # without pyplot: no state, no display

    figure = Figure(figsize=(9, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    steps = [p.step for p in history]
    left.plot(steps, [p.loss for p in history], color="C0")
    left.set(xlabel="step", ylabel="loss (mean log squared error)", title="training scenes")
    for number, level in enumerate(history[-1].gains_db):
        right.plot(steps, [p.gains_db[level] for p in history], color=f"C{number + 1}", label=f"level {level}")
    right.axhline(0, color="0.6", linewidth=0.8)
    right.set(xlabel="step", ylabel="gain over distorted, dB", title="held-out scenes")
    right.legend(frameon=False)
    return figure
