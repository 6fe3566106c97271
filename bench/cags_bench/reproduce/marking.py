"""Names scenes for people, and marks what was measured on scenes, walks and traces that something was chosen on."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import PurePosixPath

from cags_bench.reproduce.plan import Plan
from cags_bench.reproduce.section import Cell, Curve, Plot, Section
from cags_encoder.scenes.options import split_options
from cags_research.seen import uses

MARK = " †"


def marked(section: Section, plan: Plan) -> Section:
    """``section`` with names for scenes, a mark at every row of a listed one, and what was seen of walk and trace."""
    names = titles(plan.scenes)
    known = [scene for scene in plan.scenes if uses("scene", scene)]
    rows = [[_cell(cell, names, known) for cell in row] for row in section.rows]
    notes = [f"† {scene} was seen before: {'; '.join(uses('scene', scene))}." for scene in known]
    for kind, spec in (("walk", plan.poses), ("trace", plan.trace)):
        found = uses(kind, spec)
        notes += [f"The {kind} {spec} was seen before: {'; '.join(found)}."] if found else []
    return replace(
        section,
        rows=rows,
        notes=[_named(note, names) for note in (*section.notes, *notes)],
        checks=[{**one, "value": _value(one["value"], names)} for one in section.checks],
        plots=[replace(plot, title=_named(plot.title, names), curves=_curves(plot, names)) for plot in section.plots],
        strips=[replace(strip, title=_named(strip.title, names)) for strip in section.strips],
    )


def titles(scenes: tuple[str, ...]) -> dict[str, str]:
    """Names of ``scenes``, longest spec first; two that have one name keep their specs."""
    names = {scene: title(scene) for scene in scenes}
    found = list(names.values())
    names = {scene: name if found.count(name) == 1 else scene for scene, name in names.items()}
    return dict(sorted(names.items(), key=lambda item: -len(item[0])))


def _curves(plot: Plot, names: Mapping[str, str]) -> list[Curve]:
    return [replace(curve, label=_named(curve.label, names)) for curve in plot.curves]


def _named(text: str, names: Mapping[str, str]) -> str:
    for scene, name in names.items():
        text = text.replace(scene, name)
    return text


def _value(value: object, names: Mapping[str, str]) -> object:
    return _named(value, names) if isinstance(value, str) else value


def _cell(cell: Cell, names: Mapping[str, str], known: list[str]) -> Cell:
    if not isinstance(cell, str):
        return cell
    return _named(cell, names) + (MARK if any(scene in cell for scene in known) else "")


_SPEC = re.compile(r"(?:procedural|motion):[^\s,;†]*(?:,\w+=[^\s,;†]*)*|\.{0,2}/[^\s,;†]*(?:,\w+=[^\s,;†]*)*")

_GENERIC = {"params", "meta", "point_cloud", "scene"}
"""Names of files that do not say what is in them."""


def titled(text: str) -> str:
    """``text`` with every spec of a scene in it replaced by its name."""
    return _SPEC.sub(lambda match: title(match[0]), text)


def title(spec: str) -> str:
    """Name of the scene ``spec``: ``../scenes/talking_head/params.npz:up=y`` is the talking head."""
    head, options = split_options(spec)
    if head.partition(":")[0] == "motion":
        kind = options.get("kind", "")
        return f"{title(head.partition(':')[2])} in motion" + (f" ({kind})" if kind else "")
    if head == "procedural":
        size = options.get("size", "")
        return f"room of {int(size):,} splats" if size.isdecimal() else "built-in room"
    parts = [part.partition(".")[0] for part in PurePosixPath(head).parts if part.strip("./")]
    named = [part for part in parts if re.search("[a-z]", part.lower()) and part.lower() not in _GENERIC]
    return named[-1].replace("_", " ").replace("-", " ") if named else spec
