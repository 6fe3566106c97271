"""Head-motion traces: files, resampling, placing a walk in a scene, synthetic walks.

``open_poses("walk.csv", focus)`` and ``open_poses("synthetic:walking:seed=3", focus)`` both give a :class:`PoseTrace`
in the scene's world frame that looks at the scene.
"""

from __future__ import annotations

from cags_common.errors import TraceError
from cags_common.poses.place import place
from cags_common.poses.synthetic import KINDS, synthetic_walk
from cags_common.poses.trace import Focus, PoseTrace, read_poses, write_poses

__all__ = ["KINDS", "Focus", "PoseTrace", "open_poses", "place", "read_poses", "synthetic_walk", "write_poses"]


def open_poses(spec: str, focus: Focus, *, window_us: int | None = None) -> PoseTrace:
    """The walk that ``spec`` names, in the scene's world frame.

    ``spec`` is the path of a CSV trace (placed by :func:`place` so that its first ``window_us`` look at the scene), or
    ``synthetic:KIND[:seed=N]`` with a kind of :data:`KINDS`. Raises :class:`TraceError`.
    """
    if not spec.startswith("synthetic"):
        return place(read_poses(spec), focus, window_us=window_us)
    head, *options = spec.split(":")
    if head != "synthetic" or not options:
        raise TraceError(f"{spec}: is no synthetic walk; write synthetic:KIND[:seed=N], KIND of {', '.join(KINDS)}")
    seed = 0
    for option in options[1:]:
        name, _, value = option.partition("=")
        if name != "seed" or not value.isdecimal():
            raise TraceError(f"{spec}: option {option!r} is unknown; known: seed=N")
        seed = int(value)
    return synthetic_walk(options[0], focus, seed=seed)
