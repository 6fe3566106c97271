"""Bundles compared byte for byte."""

from __future__ import annotations

from pathlib import Path


def files_of(folder: Path) -> dict[str, bytes]:
    """Name and content of every file of a bundle."""
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def assert_same_bundle(a: Path, b: Path) -> None:
    """Both hold the same files with the same bytes."""
    one, other = files_of(a), files_of(b)
    assert one.keys() == other.keys()
    assert not [name for name in one if one[name] != other[name]]
    assert "manifest.json" in one
