"""Recorded walks to fit and to judge predictors by: files by person, and people held out."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from cags_common.errors import ConfigError, TraceError
from cags_common.poses import PoseTrace, read_poses

_PERSON = re.compile(r"user[_-]?(\d+)", re.IGNORECASE)


@dataclass(frozen=True, eq=False)
class Walk:
    """One recorded walk and who walked it."""

    name: str
    person: str
    trace: PoseTrace


def read_walks(folder: str | Path) -> list[Walk]:
    """Every ``*.csv`` walk below ``folder``, in the order of names. The person is the ``userNN`` in the file's name.

    Raises :class:`TraceError` for a missing or empty folder, a malformed file, or a name without a person.
    """
    root = Path(folder)
    files = sorted(root.rglob("*.csv"))
    if not files:
        raise TraceError(f"{root}: holds no pose traces; give a folder of SCENE_userNN.csv files")
    walks = []
    for file in files:
        person = _PERSON.search(file.stem)
        if person is None:
            raise TraceError(f"{file}: its name does not say who walks; name it SCENE_userNN.csv")
        walks.append(Walk(file.stem, person[1], read_poses(file)))
    return walks


def split_people(walks: Sequence[Walk], held_out: str) -> tuple[list[Walk], list[Walk]]:
    """Walks of everybody else, and of the people of ``held_out`` (``09,10,11``). Neither may be empty."""
    names = {name.strip() for name in held_out.split(",") if name.strip()}
    known = {walk.person for walk in walks}
    if names - known:
        raise ConfigError(f"held-out people {sorted(names - known)} have no walks; known: {', '.join(sorted(known))}")
    train = [walk for walk in walks if walk.person not in names]
    test = [walk for walk in walks if walk.person in names]
    if not train or not test:
        raise ConfigError(f"held_out = {held_out!r} leaves {len(train)} walks to train on and {len(test)} to test on")
    return train, test
