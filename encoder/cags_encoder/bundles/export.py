"""Exports one frame of a bundle to a file format of other viewers."""

from __future__ import annotations

import re
from pathlib import Path

from cags_common.bundle import BundlePlayer, BundleReader
from cags_common.errors import ConfigError
from cags_encoder.formats import write_splats
from cags_encoder.formats.registry import format_of_name


def parse_place(text: str) -> tuple[int, int | None]:
    """Parse ``FRAME`` or ``FRAME:LOD``. Raises :class:`ConfigError`."""
    match = re.fullmatch(r"(\d{1,9})(?::(\d{1,3}))?", text, re.ASCII)
    if match is None:
        raise ConfigError(f"{text!r} must be FRAME or FRAME:LOD, like 0 or 12:3")
    return int(match[1]), None if match[2] is None else int(match[2])


def export(url: str, place: str, out: Path) -> tuple[int, str]:
    """Write ``FRAME[:LOD]`` of the bundle at ``url`` in the format of ``out``'s suffix; the splat count and format.

    The default is the highest LoD. Raises :class:`BundleError`, :class:`DecodeError`, :class:`ConfigError`, or
    :class:`SceneError` if the suffix is unknown or the file cannot be written.
    """
    frame, lod = parse_place(place)
    format_of_name(out)  # before the work
    with BundleReader.open(url) as reader:
        splats = BundlePlayer(reader, lod).frame(frame).splats.checked(f"{url}: frame {frame}")
    return len(splats), write_splats(out, splats).name
