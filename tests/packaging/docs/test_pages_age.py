"""Committed figures name a commit of this history, and say so where the code has moved on."""

from __future__ import annotations

import pytest

from support.page_age import HEADING, ROOT, History, Page, check_page, check_told, listed, pages

CHANGELOG = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
OLD = listed(CHANGELOG)


@pytest.fixture(scope="module")
def history() -> History:
    found = History()
    if not found.whole:
        pytest.skip("needs a checkout with its whole history")
    return found


@pytest.mark.parametrize("page", pages(), ids=lambda page: page.file)
def test_figures_are_as_old_as_the_changelog_says(page: Page, history: History) -> None:
    check_page(page, OLD, history)


def test_what_is_listed_is_there() -> None:
    assert HEADING in CHANGELOG
    assert set(OLD) <= {page.file for page in pages()}


def test_a_list_is_read() -> None:
    text = f"# Changelog\n\n{HEADING}\n\n- `docs/a.jsonl` (0b89488): no run since\n\n## 0.1.0\n\n- `b` (ecb2866)\n"
    assert listed(text) == {"docs/a.jsonl": "0b89488"}


def test_the_page_says_which_of_its_figures_are_older() -> None:
    check_told((ROOT / "docs/evaluation.md").read_text(encoding="utf-8"), OLD)
