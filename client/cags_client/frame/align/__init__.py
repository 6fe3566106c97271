"""Post-render perspective alignment (PRPA) behind one seam: ``create(name, settings) -> Aligner``."""

from __future__ import annotations

from collections.abc import Callable

from cags_client.frame.align.base import Aligned, Aligner, AlignSettings
from cags_client.frame.align.fast import FastAligner
from cags_client.store.picture import ReferencePicture
from cags_common.registry import Registry

__all__ = ["AlignSettings", "Aligned", "Aligner", "ReferencePicture", "create"]

ALIGNERS: Registry[Callable[[AlignSettings], Aligner]] = Registry("aligner", "cags.aligners", {"fast": FastAligner})
"""Aligners by name."""


def create(name: str, settings: AlignSettings | None = None) -> Aligner:
    """The aligner called ``name``. Raises :class:`~cags_common.errors.ConfigError` for an unknown one."""
    return ALIGNERS.find(name)(settings or AlignSettings())
