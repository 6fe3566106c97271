"""How old committed figures are: each names a commit of this history, and the changelog says which are out of date."""

from __future__ import annotations

import json
import re
import subprocess
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]

MEASURED = (
    "common",
    "encoder",
    "server",
    "client",
    "protocol",
    "shaper",
    "kernels",
    "research",
    "bench/cags_bench/sim",
)
"""Folders whose code decides a figure."""

ALLOWED_COMMITS = 30
"""Changes of that code since a page was measured that need no word in the changelog."""

MAY_BE_LISTED = 20
"""Changes after which it may have one already, so that the next change need not be the one that writes it."""

HEADING = "## Figures older than their code"
_LISTED = re.compile(r"^- `([^`]+)` \(([0-9a-f]{7,40})\)", re.MULTILINE)
_COMMIT = re.compile(r"\b[0-9a-f]{7,40}\b")


@dataclass(frozen=True)
class Page:
    """A committed file of figures and the commits that its lines name."""

    file: str
    commits: tuple[str, ...]


def pages(root: Path = ROOT) -> list[Page]:
    """Every committed file of figures under ``docs/evaluation``."""
    found = []
    for path in sorted((root / "docs/evaluation").rglob("*.jsonl")):
        lines = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
        named = {line["commit"].partition("-")[0] for line in lines if line.get("commit")}
        found.append(Page(str(path.relative_to(root)), tuple(sorted(named))))
    return found


def listed(changelog: str) -> dict[str, str]:
    """File and commit of what the changelog says is older than its code."""
    return dict(_LISTED.findall(changelog.partition(HEADING)[2].partition("\n## ")[0]))


class History:
    """Commits of a checkout. Only a whole one can be asked."""

    def __init__(self, root: Path = ROOT) -> None:
        self._root = root

    @property
    def whole(self) -> bool:
        """Whether there is a history, from its first commit on."""
        return self._git("rev-parse", "--is-shallow-repository") == "false"

    def holds(self, commit: str) -> bool:
        """Whether ``commit`` leads to what is checked out."""
        return self._run("merge-base", "--is-ancestor", commit, "HEAD").returncode == 0

    def changes_since(self, commit: str) -> int:
        """Commits since then that changed code which decides a figure."""
        return int(self._git("rev-list", "--count", "--no-merges", f"{commit}..HEAD", "--", *MEASURED))

    def _git(self, *words: str) -> str:
        return self._run(*words).stdout.strip()

    def _run(self, *words: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(["git", *words], cwd=self._root, capture_output=True, text=True, check=False)


def check_page(page: Page, old: dict[str, str], history: History) -> None:
    """Raise :class:`AssertionError` for a page of no known commit, and for one whose age the changelog has wrong."""
    said = old.get(page.file)
    commits = page.commits or ((said,) if said else ())
    assert commits, f"{page.file} names no commit: measure it again, or list it in CHANGELOG.md"
    assert said is None or said in commits, f"{page.file}: the changelog says {said}, the page {', '.join(commits)}"
    for commit in commits:
        assert history.holds(commit), f"{page.file}: {commit} is no commit of this history"
    changes = max(history.changes_since(commit) for commit in commits)
    if changes > ALLOWED_COMMITS:
        assert said is not None, f"{page.file} is {changes} changes older than its code: measure it again or list it"
    elif page.commits and changes <= MAY_BE_LISTED:
        assert said is None, f"{page.file} is up to date: take it off the list in CHANGELOG.md"


def check_told(text: str, old: dict[str, str]) -> None:
    """The page of words says of every commit that is out of date that it is."""
    said = text.partition("## ")[0] + text.partition("## Summary")[2].partition("\n## ")[0]
    missing = {commit for commit in old.values() if commit not in _COMMIT.findall(said)}
    assert not missing, f"docs/evaluation.md does not say in its summary that {', '.join(sorted(missing))} is older"
