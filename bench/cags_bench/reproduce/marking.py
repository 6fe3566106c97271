"""Marks what was measured on scenes, walks and traces that something was trained or chosen on."""

from __future__ import annotations

from dataclasses import replace

from cags_bench.reproduce.plan import Plan
from cags_bench.reproduce.section import Cell, Section
from cags_research.seen import uses

MARK = " †"


def marked(section: Section, plan: Plan) -> Section:
    """``section`` with a mark at every row of a scene that is listed, and a note of what was seen of walk and trace."""
    known = [scene for scene in plan.scenes if uses("scene", scene)]
    rows = [[_marked(cell, known) for cell in row] for row in section.rows]
    notes = [f"† {scene} was seen before: {'; '.join(uses('scene', scene))}." for scene in known]
    for kind, spec in (("walk", plan.poses), ("trace", plan.trace)):
        found = uses(kind, spec)
        notes += [f"The {kind} {spec} was seen before: {'; '.join(found)}."] if found else []
    return replace(section, rows=rows, notes=[*section.notes, *notes])


def _marked(cell: Cell, known: list[str]) -> Cell:
    return cell + MARK if isinstance(cell, str) and any(scene in cell for scene in known) else cell
