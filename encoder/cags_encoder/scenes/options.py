"""The text form of a scene: ``PATH[:key=value,...]``, ``procedural[:...]``, ``motion:PATH[:...]``."""

from __future__ import annotations

import re
import types
import typing
from collections.abc import Sequence
from dataclasses import fields
from typing import TYPE_CHECKING, Any, TypeVar, cast

from cags_common.errors import ConfigError

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

    S = TypeVar("S", bound=DataclassInstance)
else:
    S = TypeVar("S")

EVERYWHERE = ("shuffle", "quantise")
"""Options of all scenes, removed before a scene's own: :class:`cags_encoder.scenes.disguised.DisguiseOptions`."""

_OPTIONS = re.compile(r"\A(?P<head>.*?)(?::(?P<options>\w+=[^,:=]*(?:,\w+=[^,:=]*)*))?\Z", re.DOTALL)


def split_options(spec: str) -> tuple[str, dict[str, str]]:
    """Split ``head:key=value,key=value`` into head and options. Raises :class:`ConfigError` for repeated keys."""
    match = _OPTIONS.match(spec)
    assert match is not None  # the pattern matches every string
    options: dict[str, str] = {}
    for pair in (match["options"] or "").split(","):
        key, _, value = pair.partition("=")
        if key in options:
            raise ConfigError(f"scene {spec!r}: option {key!r} is given twice; give it once")
        if key:
            options[key] = value
    return match["head"], options


def parse_options(cls: type[S], spec: str, options: dict[str, str], others: Sequence[str] = ()) -> S:
    """Build the settings dataclass ``cls`` from ``options``; ``spec`` names the scene in :class:`ConfigError`.

    ``others`` are options of the scene that were taken before; errors list them too.
    """
    hints = typing.get_type_hints(cls)
    names = [f.name for f in fields(cast("Any", cls))]
    values: dict[str, Any] = {}
    for key, text in options.items():
        if key not in names:
            known = [*names, *(name for name in (*others, *EVERYWHERE) if name not in names)]
            raise ConfigError(f"scene {spec!r}: unknown option {key!r}; known: {', '.join(known)}")
        values[key] = _convert(spec, key, text, hints[key])
    try:
        return cls(**values)
    except ConfigError as error:
        raise ConfigError(f"scene {spec!r}: {error}") from error


def _convert(spec: str, key: str, text: str, hint: Any) -> Any:
    members = typing.get_args(hint) if isinstance(hint, types.UnionType) else (hint,)
    kind = next(member for member in members if member is not type(None))
    try:
        return kind(text)
    except ValueError:
        raise ConfigError(f"scene {spec!r}: {key} = {text!r} must be of type {kind.__name__}") from None
