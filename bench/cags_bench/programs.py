"""Other programs used by experiments."""

from __future__ import annotations

import os
from pathlib import Path

from cags_common.errors import ConfigError


def executable(name: str, path: str) -> Path:
    """The Python of another installation, given by setting ``name`` as ``path``. Raises :class:`ConfigError`.

    Links are not resolved, because Python finds its installation by them.
    """
    found = Path(path)
    if not found.is_file() or not os.access(found, os.X_OK):
        raise ConfigError(f"{name} = {path!r} is not a program; give the python of an earlier installation")
    return found.absolute()
