"""The page's two looks: every text and every mark can be told from what it stands on (WCAG 2.2, AA)."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

SOURCES = Path(__file__).parents[3] / "web" / "src"
THEME = (SOURCES / "page" / "theme.css").read_text(encoding="utf-8")
PLOTS = (SOURCES / "client" / "plots.ts").read_text(encoding="utf-8")
TEXT_LEAST, MARK_LEAST = 4.5, 3.0
"""Contrast of text (1.4.3) and of what is no text but means something (1.4.11)."""


def colours(css: str) -> dict[str, str]:
    """The named colours of a look; a panel is as what it lets through makes it, over the stage."""
    named = dict(re.findall(r"--([\w-]+):\s*(#[0-9a-f]{6})\b", css))
    over = re.search(r"--surface:\s*rgb\((\d+) (\d+) (\d+) / (\d+)%\)", css)
    assert over
    share = int(over[4]) / 100
    under = [int(named["stage"][i : i + 2], 16) for i in (1, 3, 5)]
    mixed = (round(share * int(over[i + 1]) + (1 - share) * under[i]) for i in range(3))
    return named | {"surface": "#" + "".join(f"{value:02x}" for value in mixed)}


DARK, LIGHT = THEME.split("@media (prefers-color-scheme: light)")
LOOKS = {"dark": colours(DARK), "light": colours(LIGHT)}
LINES = re.findall(r'"(#[0-9a-f]{6})"', PLOTS.split("LINES = [", 1)[1].split("]", 1)[0])


def luminance(colour: str) -> float:
    """Relative luminance of an sRGB colour (WCAG 2.2)."""
    shares = [int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)]
    linear = [s / 12.92 if s <= 0.04045 else ((s + 0.055) / 1.055) ** 2.4 for s in shares]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def contrast(a: str, b: str) -> float:
    dark, light = sorted((luminance(a), luminance(b)))
    return (light + 0.05) / (dark + 0.05)


def test_the_measure_is_that_of_the_guidelines() -> None:
    assert contrast("#000000", "#ffffff") == pytest.approx(21)
    assert contrast("#777777", "#ffffff") == pytest.approx(4.48, abs=0.01)


@pytest.mark.parametrize("look", LOOKS)
def test_texts_can_be_read(look: str) -> None:
    for text in ("text", "quiet"):
        for ground in ("stage", "surface"):
            named = LOOKS[look]
            assert contrast(named[text], named[ground]) >= TEXT_LEAST, f"{text} on {ground}"


@pytest.mark.parametrize("look", LOOKS)
def test_marks_focus_rings_and_lines_of_plots_can_be_seen(look: str) -> None:
    named = LOOKS[look]
    marks = {name: named[name] for name in ("accent", "good", "fair", "bad")}
    for name, mark in marks.items():
        assert contrast(mark, named["surface"]) >= MARK_LEAST, name
    assert len(LINES) == 8
    for line in LINES:
        assert contrast(line, named["surface"]) >= MARK_LEAST, f"{line}: a line of the plots"
    assert contrast(named["accent"], named["stage"]) >= MARK_LEAST, "ring round the picture"
