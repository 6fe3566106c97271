"""Post-render perspective alignment (PRPA) behind one seam: ``create(name, settings) -> Aligner``."""

from __future__ import annotations

from collections.abc import Callable

import cags_kernels
from cags_client.align.base import Aligned, Aligner, AlignSettings, ReferencePicture
from cags_client.align.cpu import CpuAligner
from cags_client.align.fast import FastAligner
from cags_client.align.reference import ReferenceAligner
from cags_client.align.rotation import RotationAligner
from cags_client.align.unaligned import UnalignedAligner
from cags_common.errors import ConfigError

__all__ = ["AlignSettings", "Aligned", "Aligner", "ReferencePicture", "create"]

ALIGNERS: dict[str, Callable[[AlignSettings], Aligner]] = {
    "reference": ReferenceAligner,
    "fast": FastAligner,
    "cpu": CpuAligner,
    "unaligned": UnalignedAligner,
    "rotation": RotationAligner,
}
"""Aligners by name."""


def create(name: str, settings: AlignSettings | None = None) -> Aligner:
    """The aligner called ``name``; ``auto`` is the fastest here. Raises :class:`ConfigError` for an unknown one."""
    if name == "auto":
        name = "cpu" if cags_kernels.native_available() else "fast"
    if name not in ALIGNERS:
        raise ConfigError(f"aligner {name!r} is unknown; known: auto, {', '.join(ALIGNERS)}")
    return ALIGNERS[name](settings or AlignSettings())
