"""Figures of a play: which direction is better, and how they are printed."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

HIGHER, LOWER, EITHER = 1, -1, 0
"""Direction in which a figure is better; EITHER for figures that only describe the use of the link."""


def _plain(digits: int) -> Callable[[float], str]:
    return lambda value: f"{round(value, digits) + 0.0:.{digits}f}"  # no minus sign before zero


def _scaled(factor: float, digits: int) -> Callable[[float], str]:
    plain = _plain(digits)
    return lambda value: plain(factor * value)


@dataclass(frozen=True)
class Figure:
    """One figure of a play."""

    key: str
    title: str
    unit: str
    """Unit, and what distinguishes the figure from others of the same title."""
    better: int
    text: Callable[[float], str]
    """Formats a value in that unit."""

    @property
    def name(self) -> str:
        """Title and unit in one line."""
        return f"{self.title} [{self.unit}]" if self.unit else self.title

    def of(self, line: Mapping[str, Any]) -> float | None:
        """The value in a result line; None if it was not measured."""
        value = line.get(self.key)
        return None if value is None or not math.isfinite(value) else float(value)

    def shown(self, line: Mapping[str, Any]) -> str:
        """The value as a cell of a table."""
        value = self.of(line)
        return "" if value is None else self.text(value)


PICTURE = "picture"

GROUPS: dict[str, tuple[Figure, ...]] = {
    "motion": (
        Figure("frames", "shown", "frames", HIGHER, _plain(0)),
        Figure("frames_dropped", "skipped", "frames", LOWER, _plain(0)),
        Figure("frames_missed", "stale", "frames", LOWER, _plain(0)),
        Figure("even_share", "even", "% gaps", HIGHER, _scaled(100, 1)),
        Figure("freezes", "freezes", "", LOWER, _plain(0)),
        Figure("frozen_ms", "frozen", "ms", LOWER, _plain(0)),
        Figure("latency_p95_ms", "late", "p95, ms", LOWER, _plain(0)),
        Figure("first_picture_ms", "picture", "ms", LOWER, _plain(0)),
        Figure("first_frame_ms", "play", "ms", LOWER, _plain(0)),
    ),
    PICTURE: (
        Figure("psnr_restored_db", "PSNR", "dB", HIGHER, _plain(2)),
        Figure("psnr_restored_p5_db", "PSNR", "p5, dB", HIGHER, _plain(2)),
        Figure("psnr_restored_step_p95_db", "steps", "p95, dB", LOWER, _plain(2)),
        Figure("flicker_restored", "flicker", "/255", LOWER, _plain(2)),
        Figure("ssim_restored", "SSIM", "", HIGHER, _plain(4)),
        Figure("lpips_restored", "LPIPS", "", LOWER, _plain(4)),
        Figure("vmaf", "VMAF", "", HIGHER, _plain(1)),
        Figure("xpsnr_db", "XPSNR", "dB", HIGHER, _plain(2)),
        Figure("jod", "JOD", "", HIGHER, _plain(2)),
    ),
    "link": (
        Figure("bytes_tiles", "tiles", "MB", EITHER, _scaled(1e-6, 3)),
        Figure("bytes_reference", "references", "MB", EITHER, _scaled(1e-6, 3)),
        Figure("goodput_mbps", "goodput", "Mbps", EITHER, _plain(2)),
        Figure("wasted_share", "wasted", "%", LOWER, _scaled(100, 1)),
        Figure("lod_mean", "level", "mean", EITHER, _plain(2)),
        Figure("level_switches", "switches", "of level", LOWER, _plain(0)),
    ),
}
"""Tables of a report, with the figures in their columns."""

FIGURES = tuple(figure for group in GROUPS.values() for figure in group)
