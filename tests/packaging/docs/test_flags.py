"""Every flag that the pages, the change log and the README tell of is one that the command has."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from support.command_flags import FLAG, MODULES, every_flag, flags_of, parts

ROOT = Path(__file__).parents[3]
PAGES = [
    *sorted(page for page in (ROOT / "docs").rglob("*.md") if page.parent.name != "lab"),  # notes of former states
    *(ROOT / folder / "README.md" for folder in (".", "kernels", "protocol", "server", "shaper", "traces")),
    ROOT / "CHANGELOG.md",
]
OF_OTHERS = {
    "pip": {"--extra-index-url", "--force-reinstall"},
    "docker compose": {"--build", "--abort-on-container-exit", "--profile"},
    "dask": {"--port", "--nthreads", "--nworkers"},
    "curl": {"--cacert"},
}
"""Flags of other programs that the pages tell people to use."""


def told(text: str) -> list[tuple[str, str, set[str]]]:
    """(command, part, flags) of each command line in a page: in blocks and in inline code."""
    found = []
    for span in re.findall(r"`([^`\n]+)`", text) + re.findall(r"^```\w+\n(.*?)^```", text, re.M | re.S):
        for line in re.split(r"\n|&&|;|\|", span.replace("\\\n", " ")):
            match = re.search(r"\b(cags-[a-z]+)\b(.*)", line.split(" #")[0])
            if match and match[1] in MODULES:
                words = match[2].split()
                part = words[0] if words and words[0] in parts().get(match[1], ()) else ""
                found.append((match[1], part, set(FLAG.findall(match[2].split(" -- ")[0]))))
    return found


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_commands_have_the_flags_that_the_page_shows_them_with(page: Path) -> None:
    for command, part, flags in told(page.read_text(encoding="utf-8")):
        assert flags <= flags_of(command, part), f"{command} {part}: {sorted(flags - flags_of(command, part))}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_flags_told_of_alone_are_those_of_some_command(page: Path) -> None:
    flags = set(FLAG.findall(page.read_text(encoding="utf-8")))
    assert flags <= every_flag().union(*OF_OTHERS.values())


def test_the_search_finds_what_it_is_for() -> None:
    text = "Use `cags-server --port 0` and\n\n```sh\ncags-bench stream \\\n    --scene x | tail  # --no\n```\n"
    assert told(text) == [("cags-server", "", {"--port"}), ("cags-bench", "stream", {"--scene"})]
