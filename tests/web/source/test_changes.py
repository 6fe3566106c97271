"""What the page takes for changed since a reference was made."""

from __future__ import annotations

from pathlib import Path

from support.node import run_tests


def test_the_page_judges_what_has_changed_as_the_client_does(tmp_path: Path) -> None:
    run_tests("changes", tmp_path)
