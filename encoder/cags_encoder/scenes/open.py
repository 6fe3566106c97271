"""One spec string to one :class:`FrameSource`."""

from __future__ import annotations

from pathlib import Path

from cags_common.errors import ConfigError
from cags_encoder.scenes.file_options import FileOptions
from cags_encoder.scenes.files import open_files
from cags_encoder.scenes.motion import MotionOptions, MotionScene
from cags_encoder.scenes.options import parse_options, split_options
from cags_encoder.scenes.procedural import ProceduralScene, ProceduralSettings
from cags_encoder.scenes.source import FrameSource

MOTION = "motion:"


def open_scene(spec: str) -> FrameSource:
    """Open the scene that ``spec`` names.

    - ``procedural[:size=..,frames=..,seed=..,fps=..]``: the embedded room;
    - ``PATH[:frames=..,fps=..,up=..]``: a file, a folder with an unbundled SOG, or a folder of numbered frames;
    - ``motion:PATH[:kind=..,frames=..,share=..,...]``: the first frame of PATH, set in motion.

    Raises :class:`SceneError` for scenes that cannot be read and :class:`ConfigError` for unknown options and values
    out of range.
    """
    head, options = split_options(spec)
    if head == "procedural":
        return ProceduralScene(parse_options(ProceduralSettings, spec, options))
    if head.startswith(MOTION):
        return _open_motion(spec, head.removeprefix(MOTION), options)
    if not head:
        raise ConfigError(f"scene {spec!r} names nothing; give a file, a folder, or 'procedural'")
    if Path(spec).exists():  # an existing path wins over options, whatever characters it holds
        return open_files(Path(spec), FileOptions())
    return open_files(Path(head), parse_options(FileOptions, spec, options))


def _open_motion(spec: str, inner: str, options: dict[str, str]) -> FrameSource:
    if not inner:
        raise ConfigError(f"scene {spec!r} names no capture; give motion:PATH")
    of_file = ",".join(f"{key}={options.pop(key)}" for key in ("up", "focus") if key in options)
    return MotionScene(
        open_scene(f"{inner}:{of_file}" if of_file else inner), parse_options(MotionOptions, spec, options)
    )
