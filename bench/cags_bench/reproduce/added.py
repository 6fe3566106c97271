"""Policies, predictors and restorers that somebody added: each is a method beside ours, with ours but for that part.

They are found where the program finds them: in the registries, by entry points of installed packages or entered by the
program's caller. Names are ``abr=NAME``, ``fov=NAME``, ``predictor=NAME`` and ``restore=NAME``.
"""

from __future__ import annotations

import hashlib
import inspect
import sys
from dataclasses import dataclass
from functools import cache
from importlib.metadata import entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from cags_client.frame.restore import RESTORERS
from cags_common.registry import Registry
from cags_server.fov import FOV_POLICIES
from cags_server.predict import PREDICTORS
from cags_server.ratecontrol import RATE_POLICIES

DISTRIBUTION = "cags-stream"
OWN_PACKAGES = frozenset({"cags_common", "cags_client", "cags_server", "cags_research"})
"""Where the program's own implementations are."""


@dataclass(frozen=True)
class Seam:
    """A setting that names an implementation."""

    side: str
    """``server`` or ``client``."""
    what: str
    registry: Registry[Any]


SEAMS: dict[str, Seam] = {
    "abr": Seam("server", "rate policy", RATE_POLICIES),
    "fov": Seam("server", "field-of-view policy", FOV_POLICIES),
    "predictor": Seam("server", "predictor", PREDICTORS),
    "restore": Seam("client", "restorer", RESTORERS),
}


def names() -> tuple[str, ...]:
    """Every method that was added, as ``abr=NAME``."""
    return tuple(f"{setting}={name}" for setting, seam in SEAMS.items() for name in _added(seam))


def split(method: str) -> tuple[str, Seam, str]:
    """Setting, seam and name of what ``method`` adds. Raises :class:`KeyError` where it adds nothing."""
    setting, _, name = method.partition("=")
    if setting not in SEAMS or name not in _added(SEAMS[setting]):
        raise KeyError(method)
    return setting, SEAMS[setting], name


def digest(method: str) -> str:
    """Digest of the file that ``method``'s implementation is in; empty for methods of the program's own."""
    try:
        _, seam, name = split(method)
    except KeyError:
        return ""
    if name in seam.registry:
        file = _file_of(seam.registry[name])
    else:
        [entry, *_] = entry_points(group=seam.registry.group, name=name)
        spec = find_spec(entry.module)
        file = spec.origin if spec else None
    return hashlib.sha256(Path(file).read_bytes()).hexdigest()[:16] if file and Path(file).is_file() else ""


def _added(seam: Seam) -> list[str]:
    """Names that are not the program's own, in order."""
    entered = [name for name, made in seam.registry.items() if _package(made) not in OWN_PACKAGES]
    return [*entered, *sorted(_installed(seam.registry.group, tuple(sys.path)) - seam.registry.keys())]


@cache
def _installed(group: str, path: tuple[str, ...]) -> frozenset[str]:
    """Names of other distributions' entry points on ``path``, cached: every method name is checked against them."""
    others = entry_points(group=group)
    return frozenset(entry.name for entry in others if entry.dist is None or entry.dist.name != DISTRIBUTION)


def _package(made: Any) -> str:
    return str(getattr(made, "__module__", "")).partition(".")[0]


def _file_of(made: Any) -> str | None:
    try:
        return inspect.getsourcefile(made)
    except TypeError:
        return None
