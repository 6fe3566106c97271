"""Other programs that experiments run."""

from __future__ import annotations

import os
from pathlib import Path

from cags_common.errors import ConfigError


def executable(name: str, path: str) -> Path:
    """The Python of another installation, which setting ``name`` gives as ``path``. Raises :class:`ConfigError`.

    Links are not followed: they tell an installation which it is.
    """
    found = Path(path)
    if not found.is_file() or not os.access(found, os.X_OK):
        raise ConfigError(f"{name} = {path!r} is no program; give the python of an earlier installation")
    return found.absolute()
