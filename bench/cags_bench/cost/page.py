"""The page of ``cags-bench cost``: one self-contained HTML file, and the points as JSON lines and CSV."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from cags_bench import html
from cags_bench.confidence import Interval
from cags_bench.cost.comparing import (
    TIME,
    cost_ratio,
    default_of,
    gain,
    line,
    marginal_ms_per_db,
    neighbours,
    pareto,
    quality_of,
    verdict,
)
from cags_bench.cost.engine import Measured
from cags_bench.cost.moments import LIKE_SPLATS
from cags_bench.cost.settings import CostSettings
from cags_bench.jsonl import JsonObject, dump, provenance
from cags_bench.reproduce.marking import titles
from cags_common.files import writable_folder, write_whole
from cags_research.seen import uses

Group = Sequence[Measured]

WIDE = 20
"""Ratio of times from which a plot's axis is logarithmic."""


def write_page(out: Path, groups: Sequence[Group], checks: Sequence[JsonObject], settings: CostSettings) -> None:
    """Write ``index.html``, ``points.jsonl`` and ``points.csv`` to ``out``. Raises :class:`OutputError`."""
    writable_folder(out)
    lines = [line(one, default_of(group)) for group in groups for one in group]
    text = "".join(dump(each | provenance()) + "\n" for each in lines)
    write_whole(out / "points.jsonl", text.encode())
    _write_csv(out / "points.csv", lines)
    by_stage: dict[str, list[Group]] = {}
    for group in groups:
        by_stage.setdefault(group[0].stage.name, []).append(group)
    body = [_intro(settings), _checks(checks), _summary(by_stage), *map(_section, by_stage.values())]
    write_whole(out / "index.html", html.page("Cost of accuracy", body).encode())


def _intro(settings: CostSettings) -> str:
    names = titles(tuple(settings.scene_list))
    scenes = ", ".join(f"{names[scene]} ({Path(scene).name})" for scene in settings.scene_list)
    seen = [f"{names[scene]}: {'; '.join(known)}" for scene in settings.scene_list if (known := uses("scene", scene))]
    before = f" Seen before the measurement: {html.escape('. '.join(seen))}." if seen else ""
    sizes = " and ".join(f"{width}x{height}" for width, height in settings.size_list)
    link = (
        f"{settings.share:g} of {settings.trace}, for {LIKE_SPLATS:,} splats and the same bits a splat for each scene"
    )
    return (
        f"<p>Scenes: {html.escape(scenes)}; {sizes} pixels; link: {html.escape(link)}; head motion: "
        f"{html.escape(settings.poses)}.{before}</p>"
        f"<p class=note>Each point is run and judged at {settings.moments} moments of a session of every scene, "
        "interleaved with all others. Quality is the mean with its 95 % interval (Student's t); the gain over the "
        "default is paired by moment, and a point is called better or worse only where that interval excludes zero. "
        "The intervals are for these moments: other scenes differ by more, and of a hundred comparisons a few exclude "
        "zero by chance. Times are medians and interquartile ranges on this machine; 'times' is the mean ratio to the "
        "default's, paired by moment. Bold and starred: the defaults. Line: the Pareto front. Stages named "
        f"'session' are whole sessions of {settings.frames} frames in virtual time, at the smaller size: PSNR over "
        "covered pixels in parts of nine frames; their time is processor time of server and client together for a "
        "frame, on one thread.</p>"
    )


def _checks(checks: Sequence[JsonObject]) -> str:
    rows = "".join(
        f"<tr><td>{html.escape(one['name'])}</td><td class=words>{html.escape(one['target'])}</td>"
        f"<td class=words>{html.escape(_value(one['value']))}</td>"
        f"<td class={'held' if one['ok'] else 'missed'}>{'yes' if one['ok'] else 'no'}</td></tr>"
        for one in checks
    )
    return (
        f"<table><tr><th>check</th><th class=words>target</th><th class=words>found</th><th>met</th></tr>{rows}</table>"
    )


def _value(value: Any) -> str:
    return ("; ".join(map(str, value)) or "none") if isinstance(value, list) else str(value)


def _summary(by_stage: dict[str, list[Group]]) -> str:
    """What each default costs and brings against its neighbours on the front, one table per size."""
    sizes: dict[str, list[Group]] = {}
    for groups in by_stage.values():
        for group in groups:
            sizes.setdefault(group[0].size, []).append(group)
    columns = ["stage", "default", "next cheaper", "takes", "gains", "next dearer", "takes", "gains"]
    parts = ["<h2>What the defaults cost and bring</h2>"]
    for size, groups in sizes.items():
        rows = [row for group in groups if (row := _neighbours_row(group))]
        title = f"At {size}" if size else "Whatever the size"
        parts.append(f"<h3>{title}</h3>" + html.table(columns, rows))
    parts.append(
        "<p class=note>Neighbours in time on the front. 'Takes': time as a multiple of the default's; 'gains': quality "
        "over the default, in the stage's unit (dB, or as its table says), positive is better.</p>"
    )
    return "".join(parts)


def _neighbours_row(group: Group) -> list[str] | None:
    default = default_of(group)
    if default is None:
        return None
    row = [group[0].stage.name, default.label]
    for other in neighbours(group):
        if other is None:
            row += ["–", "", ""]
        else:
            row += [other.label, f"{cost_ratio(other, default).mean:.2f} x", _gain(gain(other, default))]
    return row


def _gain(found: Interval) -> str:
    """A gain with its interval, and what it is sure of."""
    if not found.bounded:
        return f"{found.mean:+.3g}"
    text = f"{found.mean:+.3g} [{found.low:+.3g}, {found.high:+.3g}]"
    return f"{text} {verdict(found)}".rstrip()


def _section(groups: Sequence[Group]) -> str:
    stage = groups[0][0].stage
    head = f"<h2>{html.escape(stage.name)} <span class=note>({stage.side}; {html.escape(stage.knob)})</span></h2>"
    plots = "".join(f"<figure>{_plot(group)}</figure>" for group in groups)
    return head + f"<div class=strip>{plots}</div>" + "".join(map(_table, groups))


def _table(group: Group) -> str:
    stage, default = group[0].stage, default_of(group)
    others = [key for key in group[0].figures if key != stage.quality]
    columns = ["point", "ms", "range [ms]", "times", stage.quality, "± (95 %)", "gain over the default"]
    columns += [f"{key}, times" if key in stage.costs else key for key in others]
    rows = []
    for one in group:
        compared = default is not None and default is not one
        found = quality_of(one)
        cells: list[Any] = [one.label, one.median_ms, one.spread_ms]
        cells += [_times(one, default, TIME) if compared else "", one.quality, _half(found)]
        cells += [_gain(gain(one, default)) if default is not None and compared else ""]
        for key in others:
            value = html.short(one.mean(key))
            cells.append(f"{value}, {_times(one, default, key)}" if compared and key in stage.costs else value)
        rows.append(cells)
    costs = "".join(
        f"<li>{html.escape(a)} to {html.escape(b)}: {ms:.3g} ms per additional dB</li>"
        for a, b, ms in marginal_ms_per_db(pareto(group))
    )
    size = f"<h3>{group[0].size}</h3>" if group[0].size else ""
    return size + html.table(columns, rows, (one.default for one in group)) + f"<ul>{costs}</ul>"


def _half(found: Interval) -> float | None:
    """Half the width of a bounded interval."""
    return (found.high - found.low) / 2 if found.bounded else None


def _times(one: Measured, default: Measured | None, cost: str) -> str:
    """A cost as a multiple of the default's, with its interval."""
    if default is None:
        return ""
    found = cost_ratio(one, default, cost)
    if not found.bounded:
        return "–" if math.isnan(found.mean) else f"{found.mean:.2f}"
    return f"{found.mean:.2f} [{found.low:.2f}, {found.high:.2f}]"


def _plot(group: Group) -> str:
    key, size = group[0].stage.quality, group[0].size
    figure, axes = html.new_figure(4.8, 2.9)
    front = pareto(group)
    axes.plot([one.median_ms for one in front], [one.quality for one in front], "-", color="tab:blue")
    for one in group:
        found, at = quality_of(one), (one.median_ms, one.quality)
        low_ms, high_ms = one.quartiles_ms
        up = [[found.mean - found.low], [found.high - found.mean]] if found.bounded else None
        along = [[max(one.median_ms - low_ms, 0.0)], [max(high_ms - one.median_ms, 0.0)]]
        marker = "*" if one.default else "."
        axes.errorbar(*at, yerr=up, xerr=along, fmt=marker, color="tab:red", ms=11, elinewidth=0.8, alpha=0.8)
        axes.annotate(one.label.partition(":")[0], at, fontsize=7, xytext=(4, 4), textcoords="offset points")
    if max(one.median_ms for one in group) > WIDE * min(one.median_ms for one in group) > 0:
        axes.set_xscale("log")
    axes.set_xlabel("ms" + (f", {size}" if size else ""))
    axes.set_ylabel(key)
    return html.picture(figure, f"{key} against time" + (f" at {size}" if size else ""))


def _write_csv(path: Path, lines: Iterable[dict[str, Any]]) -> None:
    lines = list(lines)
    columns = list(dict.fromkeys(key for each in lines for key in each))
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, columns)
    writer.writeheader()
    writer.writerows(lines)
    write_whole(path, text.getvalue().encode())
