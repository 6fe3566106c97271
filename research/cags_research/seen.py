"""Scenes, walks and traces that were trained on, or that constants were chosen on: figures measured on them say so.

The list is ``seen.toml`` beside this file. Whoever trains on something, or chooses a constant by it, adds it there.
"""

from __future__ import annotations

import functools
import tomllib
from collections.abc import Iterable
from dataclasses import dataclass
from fnmatch import fnmatchcase
from importlib import resources

KINDS = ("scene", "walk", "trace")


@dataclass(frozen=True, slots=True)
class Seen:
    """One entry of the list."""

    kind: str
    """One of :data:`KINDS`."""
    spec: str
    """Pattern of its last path part, or of the whole of what is generated."""
    use: str
    """What it was used for."""


@functools.cache
def listed() -> tuple[Seen, ...]:
    """The whole list. Raises :class:`ValueError` for an entry that is none."""
    text = resources.files("cags_research").joinpath("seen.toml").read_text(encoding="utf-8")
    entries = tuple(Seen(entry["kind"], entry["spec"], entry["for"]) for entry in tomllib.loads(text)["seen"])
    for entry in entries:
        if entry.kind not in KINDS:
            raise ValueError(f"seen.toml: kind = {entry.kind!r} of {entry.spec!r} must be one of {', '.join(KINDS)}")
    return entries


def uses(kind: str, spec: str) -> tuple[str, ...]:
    """What the scene, walk or trace ``spec`` was used for before it is measured on; nothing: it is unseen."""
    name = spec if spec.partition(":")[0] in GENERATED else spec.rstrip("/").rpartition("/")[2]
    return tuple(entry.use for entry in listed() if entry.kind == kind and fnmatchcase(name, entry.spec))


GENERATED = ("procedural", "synthetic", "generated", "motion")
"""First words of what is made and not read."""


def unlisted(kind: str, specs: Iterable[str]) -> list[str]:
    """The ``specs`` that are not on the list."""
    return [spec for spec in specs if not uses(kind, spec)]
