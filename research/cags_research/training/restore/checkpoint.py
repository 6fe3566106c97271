"""Checkpoints: plain ``.npz``, written whole or not at all."""

from __future__ import annotations

import json
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cags_common.errors import ConfigError
from cags_common.files import whole_file
from cags_common.geometry import F32

_FACTS = "facts"


@dataclass(frozen=True, eq=False)
class Checkpoint:
    """Arrays by name, and plain facts (JSON)."""

    arrays: dict[str, F32]
    facts: dict[str, Any]

    def save(self, path: Path) -> None:
        """Replace the checkpoint at ``path``."""
        facts = np.frombuffer(json.dumps(self.facts).encode(), np.uint8)
        with whole_file(path) as writing, writing.open("wb") as file:
            np.savez(file, **{_FACTS: facts}, **self.arrays)  # type: ignore[arg-type]

    @staticmethod
    def load(path: Path) -> Checkpoint:
        """Read a checkpoint. Raises :class:`ConfigError` for a damaged one."""
        try:
            with path.open("rb") as opened, np.load(opened, allow_pickle=False) as file:
                arrays = {name: file[name] for name in file.files}
            facts = json.loads(arrays.pop(_FACTS).tobytes())
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
            raise ConfigError(f"{path}: is no checkpoint ({error}); remove it to start anew") from error
        return Checkpoint(arrays, facts)
