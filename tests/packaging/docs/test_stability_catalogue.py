"""The catalogue of hard cases names tests that exist."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).parents[3]
CATALOGUE = (ROOT / "docs" / "hard-cases.md").read_text(encoding="utf-8")
NAMED = re.findall(r"`(tests/[\w/.]+\.py)::(\w+)`", CATALOGUE)


def test_every_named_test_exists() -> None:
    missing = []
    for file, name in NAMED:
        path = ROOT / file
        text = path.read_text(encoding="utf-8") if path.exists() else ""
        if not re.search(rf"^\s*(async )?def {name}\(", text, re.MULTILINE):
            missing.append(f"{file}::{name}")
    assert not missing


def test_the_catalogue_is_not_thin() -> None:
    assert len(set(NAMED)) >= 30
    assert all(row.count("|") in (4, 5) for row in CATALOGUE.splitlines() if row.startswith("|"))
