"""Inputs of experiments: what cannot be read is refused at the start, before anything is measured."""

from __future__ import annotations

from collections.abc import Iterable

ANYWHERE = (0.0, 0.0, 0.0), 1.0, (0.0, 1.0, 0.0)
"""Centre, radius and up direction of a focus that walks are opened around if only their names are to be checked."""


def check_scenes(specs: Iterable[str]) -> None:
    """Refuse scenes that cannot be opened. Raises :class:`CagsError`."""
    from cags_encoder.scenes import open_scene

    for spec in dict.fromkeys(specs):
        open_scene(spec)


def check_traces(specs: Iterable[str]) -> None:
    """Refuse network traces that cannot be opened. Raises :class:`CagsError`."""
    from cags_shaper.trace import open_trace

    for spec in dict.fromkeys(specs):
        open_trace(spec)


def check_walks(specs: Iterable[str]) -> None:
    """Refuse walks (``--poses``) that cannot be opened. Raises :class:`CagsError`."""
    from cags_common.poses import Focus, open_poses

    for spec in dict.fromkeys(specs):
        open_poses(spec, Focus(*ANYWHERE))
