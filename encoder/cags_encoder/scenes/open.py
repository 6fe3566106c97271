"""Opens the :class:`FrameSource` of a spec string."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

from cags_common.errors import ConfigError
from cags_encoder.scenes.disguised import DisguisedScene, DisguiseOptions
from cags_encoder.scenes.file_options import FileOptions
from cags_encoder.scenes.files import exists, open_files
from cags_encoder.scenes.fourd import FourdOptions, FourdScene
from cags_encoder.scenes.motion import MotionOptions, MotionScene
from cags_encoder.scenes.options import parse_options, split_options
from cags_encoder.scenes.procedural import ProceduralScene, ProceduralSettings
from cags_encoder.scenes.source import FrameSource

MOTION = "motion:"
GENERATED = ("procedural", "fourd")
OF_CAPTURE = ("up", "focus", "repair")
"""Options of a scene in motion that are passed on to the capture."""


def open_scene(spec: str) -> FrameSource:
    """Open the scene named by ``spec``.

    - ``procedural[:size=..,frames=..,seed=..,fps=..]``: the embedded room;
    - ``fourd[:splats=..,births=..,degree=..,frames=..,..]``: a generated clip like those of 4D models;
    - ``PATH[:frames=..,fps=..,up=..]``: a file, a folder with an unbundled SOG, or a folder of numbered frames;
    - ``motion:PATH[:kind=..,frames=..,share=..,...]``: the first frame of PATH with added motion; ``up``, ``focus`` and
      ``repair`` are for PATH.

    Each also takes ``shuffle=1`` and ``quantise=sog|spz``. An existing PATH is taken whole, whatever its name contains.
    Options are checked before any file is read.

    Raises :class:`SceneError` for scenes that cannot be read and :class:`ConfigError` for unknown options and values
    out of range.
    """
    head, options = _split(spec)
    disguise = {f.name: options.pop(f.name) for f in fields(DisguiseOptions) if f.name in options}
    chosen = parse_options(DisguiseOptions, spec, disguise)
    scene = _open(spec, head, options)
    return scene if chosen == DisguiseOptions() else DisguisedScene(scene, chosen)


def _split(spec: str) -> tuple[str, dict[str, str]]:
    """Head and options; all of ``spec`` is the head where it names an existing path."""
    head, options = split_options(spec)
    path = spec.removeprefix(MOTION)
    if head.removeprefix(MOTION) not in GENERATED and path and exists(Path(path)):
        return spec, {}
    return head, options


def _open(spec: str, head: str, options: dict[str, str]) -> FrameSource:
    if head == "procedural":
        return ProceduralScene(parse_options(ProceduralSettings, spec, options))
    if head == "fourd":
        return FourdScene(parse_options(FourdOptions, spec, options))
    if head.startswith(MOTION):
        return _open_motion(spec, head.removeprefix(MOTION), options)
    if not head:
        raise ConfigError(f"scene {spec!r} has no name; give a file, a folder, or 'procedural'")
    return open_files(Path(head), parse_options(FileOptions, spec, options))


def _open_motion(spec: str, inner: str, options: dict[str, str]) -> FrameSource:
    if not inner:
        raise ConfigError(f"scene {spec!r} names no capture; give motion:PATH")
    of_file = ",".join(f"{key}={options.pop(key)}" for key in OF_CAPTURE if key in options)
    motion = parse_options(MotionOptions, spec, options, others=OF_CAPTURE)
    return MotionScene(open_scene(f"{inner}:{of_file}" if of_file else inner), motion)
