"""Cache of encoded bundles, found by content."""

from __future__ import annotations

import os
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cags_common.geometry import Vec3
    from cags_common.splats import Ids, Splats
    from cags_encoder import EncodeSettings
    from cags_encoder.scenes import Focus, FrameSource


def default_cache() -> Path:
    """``$XDG_CACHE_HOME/cags-stream/bundles``, or the same under ``~/.cache``."""
    root = os.environ.get("XDG_CACHE_HOME") or str(Path("~/.cache").expanduser())
    return Path(root) / "cags-stream" / "bundles"


def cached_bundle(scene: str, cache: str, settings: EncodeSettings, *, progress: bool = True) -> Path:
    """Folder of the bundle of ``scene``; encoded only if it is not in the cache.

    ``cache`` is the folder of bundles; empty: :func:`default_cache`. A scene with fewer than ``settings.frames`` frames
    is repeated. ``progress``: show a progress bar.
    """
    from cags_encoder import content_key, encode
    from cags_encoder.execution.progress import progress_bar
    from cags_encoder.scenes import open_scene

    folder = Path(cache) if cache else default_cache()
    bundle = folder / content_key(scene, settings)
    if not _readable(bundle):
        folder.mkdir(parents=True, exist_ok=True)
        with progress_bar() if progress else nullcontext() as tell:
            encode(looped(open_scene(scene), settings.frames), settings, str(bundle), tell)
    return bundle


def _readable(bundle: Path) -> bool:
    """Whether a bundle of the current format exists; older formats are encoded again."""
    from cags_common.bundle import BundleReader
    from cags_common.errors import BundleError

    try:
        BundleReader.open(str(bundle)).close()
    except BundleError:
        return False
    return True


@dataclass(frozen=True)
class LoopedSource:
    """A scene that repeats."""

    source: FrameSource
    length: int

    @property
    def name(self) -> str:
        """Name of the scene."""
        return self.source.name

    @property
    def fps(self) -> float:
        """Frames per second."""
        return self.source.fps

    @property
    def up(self) -> Vec3:
        """Up direction of the scene."""
        return self.source.up

    @property
    def focus(self) -> Focus:
        """Focus of the scene."""
        return self.source.focus

    def __len__(self) -> int:
        return self.length

    def frame(self, index: int) -> Splats:
        """Frame ``index`` of the loop."""
        return self.source.frame(index % len(self.source))

    def ids(self, index: int) -> Ids | None:
        """Identities of the frame's splats, the same in every repetition."""
        return self.source.ids(index % len(self.source))


def looped(source: FrameSource, frames: int | None) -> FrameSource:
    """``source``, or a loop of it with ``frames`` frames."""
    return source if frames is None or frames <= len(source) else LoopedSource(source, frames)
