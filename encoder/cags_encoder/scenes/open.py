"""One spec string to one :class:`FrameSource`."""

from __future__ import annotations

from cags_common.errors import SceneError
from cags_encoder.scenes.options import parse_options, split_options
from cags_encoder.scenes.procedural import ProceduralScene, ProceduralSettings
from cags_encoder.scenes.source import FrameSource


def open_scene(spec: str) -> FrameSource:
    """Open the scene that ``spec`` names.

    ``procedural[:size=..,frames=..,seed=..,fps=..]`` is the embedded default.
    Raises :class:`SceneError` for scenes that cannot be read and :class:`ConfigError` for options out of range.
    """
    head, options = split_options(spec)
    if head == "procedural":
        return ProceduralScene(parse_options(ProceduralSettings, spec, options))
    raise SceneError(f"{spec}: no such scene; give a file, a folder of numbered files, or 'procedural'")
