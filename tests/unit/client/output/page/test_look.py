"""The page's two looks: every text and every mark can be told from what it stands on (WCAG 2.2, AA)."""

from __future__ import annotations

import re
from importlib.resources import files

import pytest

CSS = (files("cags_client.output.page") / "static" / "style.css").read_text(encoding="utf-8")
TEXT_LEAST, MARK_LEAST = 4.5, 3.0
"""Contrast of text (1.4.3) and of what is no text but means something (1.4.11)."""


def colours(selector: str) -> dict[str, str]:
    """The named colours of a look."""
    return dict(re.findall(r"--([\w-]+):\s*(#[0-9a-f]{6})\b", CSS.split(selector + " {", 1)[1].split("}", 1)[0]))


DARK = colours(":root")
LOOKS = {"dark": DARK, "light": DARK | colours(':root[data-theme="light"]')}


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
    named = LOOKS[look]
    pairs = [(text, ground) for text in ("text", "muted") for ground in ("ground", "surface", "raised")]
    for text, ground in [*pairs, ("on-accent", "accent")]:
        assert contrast(named[text], named[ground]) >= TEXT_LEAST, f"{text} on {ground}"


@pytest.mark.parametrize("look", LOOKS)
def test_marks_lines_of_plots_and_focus_rings_can_be_seen(look: str) -> None:
    named = LOOKS[look]
    marks = ["accent", "good", "warn", "bad", *(f"s{number}" for number in range(1, 9))]
    for mark in marks:
        for ground in ("ground", "surface"):
            assert contrast(named[mark], named[ground]) >= MARK_LEAST, f"{mark} on {ground}"
    assert contrast(named["accent"], named["stage"]) >= MARK_LEAST, "ring round the picture"


@pytest.mark.parametrize("look", LOOKS)
def test_words_on_the_stage_can_be_read(look: str) -> None:
    for rule, ground in (("waiting", LOOKS[look]["stage"]), ("trouble", None)):
        body = re.search(rf"\.{rule} {{(.*?)}}", CSS)
        assert body
        (text,) = re.findall(r"(?<![\w-])color: (#[0-9a-f]{6})", body[1])
        under = ground or re.findall(r"background: (#[0-9a-f]{6})", body[1])[0]
        assert contrast(text, under) >= TEXT_LEAST, rule
