"""What an experiment gives: a table, a plot, pictures and words, in the paper's form with its numbers beside."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

Cell = str | float | int | None


@dataclass(frozen=True)
class Curve:
    """One line of a plot."""

    label: str
    x: Sequence[float]
    y: Sequence[float]


@dataclass(frozen=True)
class Plot:
    """One plot."""

    title: str
    x_label: str
    y_label: str
    curves: Sequence[Curve]


@dataclass(frozen=True)
class Picture:
    """One picture of a strip."""

    label: str
    jpeg: str
    """Base64."""


@dataclass(frozen=True)
class Strip:
    """Pictures side by side."""

    title: str
    pictures: Sequence[Picture]


@dataclass(frozen=True)
class Section:
    """One table or figure."""

    name: str
    title: str
    paper: str
    """Which of the paper's tables or figures this is, and what is different."""
    columns: Sequence[str] = ()
    rows: Sequence[Sequence[Cell]] = ()
    plots: Sequence[Plot] = ()
    strips: Sequence[Strip] = ()
    notes: Sequence[str] = ()
    checks: Sequence[dict[str, Any]] = ()

    def lines(self) -> list[dict[str, Any]]:
        """The table as JSON lines."""
        return [{"experiment": self.name, **dict(zip(self.columns, row, strict=True))} for row in self.rows]
