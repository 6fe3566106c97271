"""Findings of the doctor: one line each, with the remedy if something is missing."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Verdict(StrEnum):
    """Severity of a finding."""

    OK = "ok"
    NOTE = "note"
    """Something optional is absent, or slower than it could be."""
    MISSING = "missing"
    """Something is absent that documented commands need: the doctor exits with 1."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One finding and its remedy (empty if all is well)."""

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
