"""What the doctor finds: one line a matter, and what to do where something is missing."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Verdict(StrEnum):
    """How bad it is."""

    OK = "ok"
    NOTE = "note"
    """Something optional is absent, or slower than it could be."""
    MISSING = "missing"
    """Something is absent that commands need as the documentation has them: the doctor exits with 1."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One matter: what was found, and what to do about it (empty when all is well)."""

    matter: str
    verdict: Verdict
    found: str
    remedy: str = ""


def fine(matter: str, found: str) -> Finding:
    """All is well."""
    return Finding(matter, Verdict.OK, found)


def note(matter: str, found: str, remedy: str) -> Finding:
    """It works, but not as well as it could."""
    return Finding(matter, Verdict.NOTE, found, remedy)


def missing(matter: str, found: str, remedy: str) -> Finding:
    """It does not work."""
    return Finding(matter, Verdict.MISSING, found, remedy)
