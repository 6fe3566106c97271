"""The walks of the architecture page are names in the code, and short."""

from __future__ import annotations

import re
from importlib import import_module
from pathlib import Path

import pytest

PAGE = (Path(__file__).parents[3] / "docs/architecture.md").read_text(encoding="utf-8")
WALKS = PAGE.partition("## Three walks")[2].partition("\n## ")[0]
HOP = re.compile(r"^\d+\. `([\w.]+)`", re.MULTILINE)
NAME = re.compile(r"`(cags_\w+(?:\.\w+)*)`")
MOST = {"A pose": 8, "A tile": 14, "A reference": 10}


def found(name: str) -> bool:
    """Whether ``name`` is a package, a module, or something in one."""
    parts = name.split(".")
    for count in range(len(parts), 0, -1):
        try:
            thing = import_module(".".join(parts[:count]))
        except ModuleNotFoundError:
            continue
        for attribute in parts[count:]:
            thing = getattr(thing, attribute, None)
        return thing is not None
    return False


@pytest.mark.parametrize("name", sorted(set(NAME.findall(PAGE))))
def test_every_name_on_the_page_is_one_in_the_code(name: str) -> None:
    assert found(name), name


@pytest.mark.parametrize("walk", MOST)
def test_walks_are_short(walk: str) -> None:
    hops = HOP.findall(WALKS.partition(f"**{walk},")[2].partition("\n**")[0])
    assert 3 < len(hops) <= MOST[walk]
    assert len({hop.rsplit(".", 2)[0] for hop in hops}) >= len(hops) - 2
