"""Finds the frames of a folder and their order.

Known layouts: numbered files (``frame_0001.ply``, ``time_00000.ply``, ``clip.0001.ply``), numbered folders of unbundled
SOG, and numbered folders as written by 3DGS training (``frame1/point_cloud/iteration_1000/point_cloud.ply``; the last
iteration counts), which 3DGStream, HiCoM and TrackerSplat use for their sequences. A name's number may stand anywhere
before the format's suffix.
"""

from __future__ import annotations

import logging
import re
from itertools import pairwise
from pathlib import Path

from cags_common.errors import SceneError
from cags_encoder.formats.registry import FORMATS, META, SUFFIXES
from cags_encoder.formats.splatv import SUFFIX as SPLATV
from cags_encoder.scenes.source import MAX_FRAMES

TRAINED = "point_cloud.ply"

CLIPS = (".npz", SPLATV)
"""Suffixes of files that hold a clip each."""

_log = logging.getLogger(__name__)

_ENDINGS = sorted((entry.suffix for entry in FORMATS.values()), key=len, reverse=True)
"""Suffixes of single-file formats, those before others that they end with."""


def frame_of_folder(folder: Path) -> Path | None:
    """The single frame that ``folder`` represents, if any: an unbundled SOG, or a trained model's last iteration."""
    if (folder / META).is_file():
        return folder
    if (folder / TRAINED).is_file():
        return folder / TRAINED
    iterations = [path for path in folder.glob(f"point_cloud/iteration_*/{TRAINED}") if path.is_file()]
    return max(iterations, key=lambda path: natural_key(path.parent.name), default=None)


def numbered_frames(folder: Path) -> list[Path]:
    """The frames in ``folder`` in natural order (2 before 10), all in one format. Raises :class:`SceneError`."""
    try:
        entries = sorted(folder.iterdir(), key=lambda entry: natural_key(entry.name))
    except OSError as error:
        raise SceneError(f"{folder}: cannot be listed ({error.strerror})") from error
    named = [(entry, _frame(entry)) for entry in entries if not entry.name.startswith(".")]
    found = [(entry, frame) for entry, frame in named if frame is not None]
    if not found:
        clip = next((entry for entry in entries if entry.suffix.lower() in CLIPS and entry.is_file()), None)
        if clip is not None:
            raise SceneError(f"{folder}: holds no frames, but a clip in one file; give {clip}")
        raise SceneError(f"{folder}: holds no frames; supported are {', '.join(SUFFIXES)} and folders with {META}")
    if len(found) > MAX_FRAMES:
        raise SceneError(f"{folder}: holds {len(found)} files; the limit is {MAX_FRAMES} frames")
    kinds = sorted({frame.suffix.lower() or META for _, frame in found})
    if len(kinds) > 1:
        raise SceneError(f"{folder}: mixes {kinds[0]} and {kinds[1]}; keep one sequence of one format in a folder")
    unnumbered = [entry.name for entry, _ in found if not re.search(r"[0-9]", _stem(entry))]
    if unnumbered and len(found) > 1:
        raise SceneError(f"{folder}: {unnumbered[0]} has no frame number; name one file, or number the sequence")
    return [frame for _, frame in found]


def warn_of_gap(folder: Path, frames: list[Path]) -> None:
    """Log where numbers are missing between the :func:`numbered_frames` of ``folder``."""
    if gap := _gap([folder / frame.relative_to(folder).parts[0] for frame in frames]):
        _log.warning("%s: %s; the clip goes on without, and what follows comes earlier", folder, gap)


def _gap(entries: list[Path]) -> str:
    """The numbers that are missing between frames, in words; empty if none are. Clips of every second or tenth frame
    have steps, and names that differ in more than a number, or in a time, tell of no gap.
    """
    names = [re.split(r"([0-9]+)", _stem(entry)) for entry in entries]
    varying = [k for k, parts in enumerate(zip(*names, strict=False)) if len(set(parts)) > 1]
    if len({len(parts) for parts in names}) > 1 or len(varying) != 1 or varying[0] % 2 == 0:
        return ""
    numbers = [int(parts[varying[0]]) for parts in names]
    steps = [after - before for before, after in pairwise(numbers)]
    step = min(steps)
    if step <= 0 or any(each % step for each in steps):
        return ""
    missing = sum(each // step - 1 for each in steps)
    if not missing:
        return ""
    k = next(k for k, each in enumerate(steps) if each > step)
    of = "frame" if missing == 1 else f"{missing} frames are missing, the first of them"
    verb = "is missing " if missing == 1 else ""
    return f"{of} {numbers[k] + step} {verb}between {entries[k].name} and {entries[k + 1].name}"


def _frame(entry: Path) -> Path | None:
    if entry.is_dir():
        return frame_of_folder(entry)
    return entry if entry.suffix.lower() in SUFFIXES else None


def _stem(entry: Path) -> str:
    """The name, of a file without its format's suffix: ``a.0001`` of ``a.0001.compressed.ply``."""
    ending = next((ending for ending in _ENDINGS if entry.is_file() and entry.name.lower().endswith(ending)), "")
    return entry.name[: len(entry.name) - len(ending)]


def natural_key(name: str) -> tuple[tuple[int, int, str], ...]:
    """Sort key that compares numbers within names by value."""
    parts = re.findall(r"[0-9]+|[^0-9]+", name)
    return tuple((0, int(part[-18:]), part) if part[0] in "0123456789" else (1, 0, part) for part in parts)
