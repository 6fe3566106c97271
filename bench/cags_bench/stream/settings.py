"""Settings of a session in virtual time: its own, and those of server and client that apply."""

from __future__ import annotations

import argparse
import tomllib
import typing
from collections.abc import Mapping
from dataclasses import Field, dataclass, field, fields, make_dataclass, replace
from pathlib import Path
from typing import Any

from cags_bench.film.metrics import AUTO, chosen
from cags_client.settings import ClientSettings
from cags_common.errors import ConfigError
from cags_common.settings import add_flags, add_settings, check_settings, load_settings, setting
from cags_server.settings import ServerSettings, ServeSettings

DEFAULT_FRAMES = 60
"""Largest number of media frames that are encoded and played of a scene by default."""

COMPARED_SEEDS = 3
"""Default number of plays of each of two compared settings."""

UNREAL = frozenset(
    {"duration", "drop_late", "interpolate", "display_rate", "join_timeout", "reconnect_s", "token", "ca"}
)
"""Client settings without effect here: ``--frames`` is the duration, nothing is late, and the network does not fail."""

RENAMED = {"fov": "fov_policy"}
"""Server settings whose names the client uses for something else, and their names here."""


@dataclass(frozen=True)
class StreamSettings:
    """What is played over which link, and what is reported. Server and client have their defaults unless set here."""

    scene: str = setting("procedural", "scene or bundle: a file, a folder, motion:PATH or procedural[:size=N,...]")
    trace: str = setting("generated:lte-driving", "network trace: a file or generated:NAME")
    share: float = setting(1.0, "factor on the trace's bandwidth", low=1e-3, high=10)
    poses: str = setting("synthetic:walking", "head motion: a pose file or synthetic:NAME")
    frames: int = setting(
        0,
        f"media frames to play; 0: all of a bundle, or a scene once, up to {DEFAULT_FRAMES} frames (a still one for "
        f"{DEFAULT_FRAMES}); more than a scene has: it repeats",
        low=0,
        high=1_000_000,
    )
    seeds: int | None = setting(
        None,
        f"number of plays, each with another walk and part of the trace; default: one, or {COMPARED_SEEDS} with "
        "--compare",
        low=1,
        high=1000,
    )
    compare: str = setting("", "NAME=A,B: compare two values of a setting over the same seeds")
    estimator: str = setting("measured", "bandwidth estimator", choices=("measured", "oracle"), research=True)
    delay_ms: float = setting(20.0, "one-way propagation delay in milliseconds", low=0, high=10_000)
    queue_bytes: int | None = setting(None, "size of the link's queue in bytes; unlimited if not given", low=1504)
    draw_ms: float = setting(
        0.0,
        "time that the client takes to draw a frame, in milliseconds; late frames are dropped",
        low=0,
        high=1000,
        research=True,
    )
    quantiser: str = setting("", "quantiser configuration of a scene; empty: the encoder's default")
    lpips: str = setting("", "weights of LPIPS (.npz); empty: no LPIPS")
    video_metrics: str = setting(
        AUTO, "metrics of the film: vmaf, xpsnr, jod, comma separated; none; auto: the fast ones, vmaf and xpsnr"
    )
    cache: str = setting("", "folder of encoded bundles to reuse; empty: the user's cache folder")
    out: str = setting("", "folder for frames.jsonl, timeline.png and strip.png; empty: none")
    record: str = setting("", "MP4 file for the displayed film; empty: none")
    record_truth: bool = setting(False, "with --record: add the true picture to the right of each frame")
    strip: int | None = setting(
        None, "first of 12 consecutive frames to show side by side in film-strip.png, in --out", low=0
    )
    server: ServerSettings = field(default_factory=ServerSettings)
    client: ClientSettings = field(default_factory=ClientSettings)

    def __post_init__(self) -> None:
        check_settings(self)
        self.metrics  # noqa: B018 - refuses unknown metrics
        if self.strip is not None and not self.out:
            raise ConfigError(f"strip = {self.strip} needs a folder; give --out FOLDER")
        if self.record and not self.record.endswith(".mp4"):
            raise ConfigError(f"record = {self.record!r} must end in .mp4")
        if self.record_truth and not self.record:
            raise ConfigError("record_truth = True needs a film; give --record FILE.mp4")

    @property
    def seed_list(self) -> range:
        """Seeds to play."""
        return range(self.seeds or (COMPARED_SEEDS if self.compare else 1))

    @property
    def metrics(self) -> tuple[str, ...]:
        """Metrics of the film."""
        return chosen(self.video_metrics)


Fields = Mapping[str, tuple[str, str]]
"""Name of a setting here -> owner (``own``, ``server`` or ``client``), and its name there."""


def _fields() -> Fields:
    own = {f.name: ("own", f.name) for f in fields(StreamSettings) if "help" in f.metadata}
    server = {RENAMED.get(f.name, f.name): ("server", f.name) for f in fields(ServerSettings)}
    client = {f.name: ("client", f.name) for f in fields(ClientSettings) if f.name not in UNREAL}
    return own | server | client


FIELDS = _fields()


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of all :data:`FIELDS`."""
    add_settings(parser, StreamSettings)
    for where, cls in (("server", ServerSettings), ("client", ClientSettings)):
        add_flags(parser.add_argument_group(where), _flags(where, cls))


def _flags(where: str, cls: type[Any]) -> type[Any]:
    """A dataclass with the settings of ``cls`` under their names here."""
    hints, there = typing.get_type_hints(cls), {f.name: f for f in fields(cls)}
    names = {name: source for name, (owner, source) in FIELDS.items() if owner == where}
    return make_dataclass(
        f"{cls.__name__}Flags",
        [(name, hints[source], _copied(there[source])) for name, source in names.items()],
    )


def _copied(f: Field[Any]) -> Any:
    return field(default=f.default, metadata=f.metadata)


def load(arguments: argparse.Namespace) -> StreamSettings:
    """Settings from flags and file. The tables ``[server]`` and ``[client]`` of a file are those of the programs.

    Raises :class:`ConfigError`.
    """
    _check_file(arguments.config)
    served = argparse.Namespace(**vars(arguments) | {name: getattr(arguments, here) for name, here in RENAMED.items()})
    every = ServeSettings, ServerSettings, ClientSettings, StreamSettings
    server = load_settings(ServerSettings, served, *every)
    client = load_settings(ClientSettings, arguments, *every)
    return replace(load_settings(StreamSettings, arguments, *every), server=server, client=client)


def _check_file(path: str | None) -> None:
    """Refuse a file in which ``fov`` is ambiguous. Other errors are reported when the file is loaded."""
    try:
        table = tomllib.loads(Path(path).read_text(encoding="utf-8")) if path else {}
    except (OSError, ValueError):
        return
    both = [name for name in RENAMED if name in table]
    if both:
        raise ConfigError(f"{path}: {both[0]!r} is a setting of server and client; put it under [server] or [client]")


NO_FIGURE = frozenset({"cache", "out", "record", "record_truth", "strip", "seeds", "compare"})
"""Settings that do not affect the figures of a play."""


def changed(settings: StreamSettings, name: str, text: str) -> StreamSettings:
    """``settings`` with the setting ``name`` (with dashes or underscores) set to ``text``.

    Raises :class:`ConfigError` for unknown names and invalid values.
    """
    key = name.strip().replace("-", "_")
    if key not in FIELDS or key in NO_FIGURE:
        known = ", ".join(sorted(FIELDS.keys() - NO_FIGURE))
        raise ConfigError(f"compare: {name.strip()!r} is not a setting of a play; known: {known}")
    where, source = FIELDS[key]
    if where == "own":
        return replace(settings, **{source: _value(StreamSettings, source, text)})
    if where == "server":
        server = replace(settings.server, **{source: _value(ServerSettings, source, text)})
        return replace(settings, server=server)
    client = replace(settings.client, **{source: _value(ClientSettings, source, text)})
    return replace(settings, client=client)


def _value(cls: type[Any], name: str, text: str) -> Any:
    hint = typing.get_type_hints(cls)[name]
    kind = next(member for member in (*typing.get_args(hint), hint) if member is not type(None))
    if kind is bool:
        if text not in ("true", "false"):
            raise ConfigError(f"compare: {name} = {text!r} must be true or false")
        return text == "true"
    try:
        return kind(text)
    except ValueError:
        raise ConfigError(f"compare: {name} = {text!r} must be of type {kind.__name__}") from None
