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


SCENES = {"black": "#000000", "white": "#ffffff"}
"""What a panel may lie over: a picture of any colour; these are the extremes."""


def mixed(over: str, share: float, under: str) -> str:
    """A colour that covers ``share`` of another."""
    values = (share * int(over[i : i + 2], 16) + (1 - share) * int(under[i : i + 2], 16) for i in (1, 3, 5))
    return "#" + "".join(f"{round(value):02x}" for value in values)


def colours(css: str) -> dict[str, str]:
    """The named colours of a look. A pane (``surface``, ``panel``) stands for itself over the stage, and ``NAME-SCENE``
    for it over a scene of that colour."""
    named = dict(re.findall(r"--([\w-]+):\s*(#[0-9a-f]{6})\b", css))
    for pane, *parts in re.findall(r"--(surface|panel):\s*rgb\((\d+) (\d+) (\d+) / (\d+)%\)", css):
        own, share = "#" + "".join(f"{int(part):02x}" for part in parts[:3]), int(parts[3]) / 100
        named[pane] = mixed(own, share, named["stage"])
        named |= {f"{pane}-{scene}": mixed(own, share, colour) for scene, colour in SCENES.items()}
    return named


DARK, LIGHT = THEME.split("@media (prefers-color-scheme: light)")
LOOKS = {"dark": colours(DARK), "light": colours(LIGHT)}
PANES = {pane: [pane, *(f"{pane}-{scene}" for scene in SCENES)] for pane in ("surface", "panel")}
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
        for ground in ("stage", *PANES["surface"], *PANES["panel"]):
            named = LOOKS[look]
            assert contrast(named[text], named[ground]) >= TEXT_LEAST, f"{text} on {ground}"


@pytest.mark.parametrize("look", LOOKS)
def test_marks_focus_rings_and_lines_of_plots_can_be_seen(look: str) -> None:
    named = LOOKS[look]
    marks = {name: named[name] for name in ("accent", "good", "fair", "bad")}
    for ground in PANES["surface"]:
        for name, mark in marks.items():
            assert contrast(mark, named[ground]) >= MARK_LEAST, f"{name} on {ground}"
    assert len(LINES) == 8
    for ground in PANES["panel"]:
        for line in LINES:
            assert contrast(line, named[ground]) >= MARK_LEAST, f"{line}: a line of the plots on {ground}"
    assert contrast(named["accent"], named["stage"]) >= MARK_LEAST, "ring round the picture"
