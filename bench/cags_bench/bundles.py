"""Cache of encoded bundles, found by content."""

from __future__ import annotations

import os
from collections.abc import Callable
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


def cached_bundle(
    scene: str,
    cache: str,
    settings: EncodeSettings,
    *,
    progress: bool = True,
    source: Callable[[], FrameSource] | None = None,
) -> Path:
    """Folder of the bundle of ``scene``; encoded only if it is not in the cache.

    ``cache`` is the folder of bundles; empty: :func:`default_cache`. A scene with fewer than ``settings.frames`` frames
    is repeated. ``progress``: show a progress bar. ``source`` opens the scene in another way; None: as its spec says.
    Raises :class:`CagsError` if the scene cannot be read or the folder cannot be written.
    """
    from cags_common.files import writable_folder
    from cags_encoder import content_key, encode
    from cags_encoder.execution.progress import progress_bar
    from cags_encoder.scenes import open_scene

    folder = Path(cache) if cache else default_cache()
    bundle = folder / content_key(scene, settings)
    if not _readable(bundle):
        writable_folder(folder)
        with progress_bar() if progress else nullcontext() as tell:
            opened = source() if source else looped(open_scene(scene), settings.frames)
            encode(opened, settings, str(bundle), tell)
    return bundle


def frames_of(scene: str, most: int) -> int:
    """Number of frames to play of a scene by default: all, at most ``most``; a still scene is shown for ``most``.

    Raises :class:`CagsError` if the scene cannot be opened.
    """
    from cags_encoder.scenes import open_scene

    length = len(open_scene(scene))
    return most if length == 1 else min(length, most)


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
class _Wrapped:
    """A scene played in another way: its name, rate, up direction and focus stay."""

    source: FrameSource

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


@dataclass(frozen=True)
class LoopedSource(_Wrapped):
    """A scene that repeats."""

    length: int

    def __len__(self) -> int:
        return self.length

    def frame(self, index: int) -> Splats:
        """Frame ``index`` of the loop."""
        return self.source.frame(index % len(self.source))

    def ids(self, index: int) -> Ids | None:
        """Identities of the frame's splats, the same in every repetition."""
        return self.source.ids(index % len(self.source))


@dataclass(frozen=True)
class IdentifiedSource(_Wrapped):
    """A scene with identities that were found for it (:func:`identified`)."""

    found: tuple[Ids, ...]
    """Identities [n] by frame."""

    def __len__(self) -> int:
        return len(self.found)

    def frame(self, index: int) -> Splats:
        """Frame ``index``."""
        return self.source.frame(index)

    def ids(self, index: int) -> Ids | None:
        """Identities of the frame's splats."""
        return self.found[index]


def looped(source: FrameSource, frames: int | None) -> FrameSource:
    """``source``, or a loop of it with ``frames`` frames."""
    return source if frames is None or frames <= len(source) else LoopedSource(source, frames)


def identified(scene: str, frames: int | None, folder: Path) -> FrameSource:
    """``scene`` for ``frames`` frames with the identities of its splats, which are kept in ``folder``.

    Where a source knows no identities, the encoder links splats from frame to frame. That depends on the source alone,
    and takes most of an encoding's time where everything changes, so several encodings share it. A scene that knows its
    identities, and a single frame, come as they are.
    """
    import io

    import numpy as np

    from cags_common.files import writable_folder, write_whole
    from cags_encoder import EncodeSettings, content_key
    from cags_encoder.scenes import open_scene
    from cags_encoder.tracks.identity import IdentityTracker
    from cags_encoder.tracks.looking import Look

    source = looped(open_scene(scene), frames)
    if frames == 1 or source.ids(0) is not None:
        return source
    count = len(source) if frames is None else frames
    path = folder / f"{content_key(scene, EncodeSettings(frames=frames))}.npz"
    if not path.exists():
        writable_folder(folder)
        tracker, file = IdentityTracker(), io.BytesIO()
        looks = ((f"{scene}, frame {at}", Look(source.frame(at), None)) for at in range(count))
        found = [frame.ids for frame in tracker.follow(looks)]
        np.savez(file, *found)
        write_whole(path, file.getvalue())
    with np.load(path) as kept:
        return IdentifiedSource(source, tuple(kept[f"arr_{at}"] for at in range(count)))
