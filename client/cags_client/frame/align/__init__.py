"""Post-render perspective alignment (PRPA) behind one seam: ``create(name, settings) -> Aligner``."""

from __future__ import annotations

from collections.abc import Callable

from cags_client.frame.align.base import Aligned, Aligner, AlignSettings
from cags_client.frame.align.fast import FastAligner
from cags_client.frame.align.oracle import OracleAligner
from cags_client.frame.align.rotation import RotationAligner
from cags_client.frame.align.unaligned import UnalignedAligner
from cags_client.store.picture import ReferencePicture
from cags_common.errors import ConfigError

__all__ = ["AlignSettings", "Aligned", "Aligner", "ReferencePicture", "create"]

ALIGNERS: dict[str, Callable[[AlignSettings], Aligner]] = {
    "reference": OracleAligner,
    "fast": FastAligner,
    "unaligned": UnalignedAligner,
    "rotation": RotationAligner,
}
"""Aligners by name."""


def create(name: str, settings: AlignSettings | None = None) -> Aligner:
    """The aligner called ``name``. Raises :class:`ConfigError` for an unknown one."""
    if name not in ALIGNERS:
        raise ConfigError(f"aligner {name!r} is unknown; known: {', '.join(ALIGNERS)}")
    return ALIGNERS[name](settings or AlignSettings())
