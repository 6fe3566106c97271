"""Settings: one frozen dataclass gives a command its flags, its TOML keys, its checks and its help.

    @dataclass(frozen=True)
    class ServerSettings:
        port: int = setting(8765, "TCP port to listen on; 0 picks a free one", low=0, high=65535)

Flags win over the file, the file over the defaults. Unknown keys are refused by name.
"""

from __future__ import annotations

import argparse
import math
import tomllib
import types
import typing
from collections.abc import Collection
from dataclasses import MISSING, Field, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn, TypeVar, cast

from cags_common.errors import ConfigError

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

    S = TypeVar("S", bound=DataclassInstance)
else:
    S = TypeVar("S")


def setting(
    default: Any,
    help: str,
    *,
    low: float | None = None,
    high: float | None = None,
    choices: tuple[str, ...] | None = None,
    research: bool = False,
) -> Any:
    """A dataclass field with a one-line description (unit included) and its range ``[low, high]`` or its choices.

    One that only ``research`` changes is shown by ``--help-all`` and not by ``--help``.
    """
    metadata = {"help": help, "low": low, "high": high, "choices": choices, "research": research}
    return field(default=default, metadata=metadata)


def parameter(default: Any, help: str, *, low: float | None = None, high: float | None = None) -> Any:
    """As :func:`setting`, for what one part of the program passes to another: no command has a flag for it."""
    return setting(default, help, low=low, high=high)


def check_settings(settings: DataclassInstance) -> None:
    """Check every field against its type, range and choices, from ``__post_init__``. Raises :class:`ConfigError`."""
    hints = typing.get_type_hints(type(settings))
    for f in fields(settings):
        value = getattr(settings, f.name)
        kind, optional = _plain_type(hints[f.name])
        if value is None and optional:
            continue
        if value == "" and optional:
            raise ConfigError(f"{f.name} is empty; give a name, or leave it out")
        _check_value(f, kind, value)


def check_printable(name: str, text: str) -> None:
    """Raise :class:`ConfigError` for control characters, line breaks and undecodable bytes in setting ``name``."""
    strange = next((character for character in text if not character.isprintable()), None)
    if strange is not None:
        flag = name.replace("_", "-")
        raise ConfigError(
            f"{name} has the character U+{ord(strange):04X}, which is not printable; give --{flag} on one line, "
            "without control characters"
        )


def names_in(text: str, name: str, known: Collection[str]) -> list[str]:
    """The names in ``text``, separated by commas, of setting ``name``. Raises :class:`ConfigError` for unknown ones."""
    names = [word.strip() for word in text.split(",")]
    for word in names:
        if word not in known:
            raise ConfigError(f"{name}: {word!r} is unknown; known: {', '.join(known)}")
    return names


def add_settings(parser: argparse.ArgumentParser, cls: type[DataclassInstance]) -> None:
    """Add ``--config FILE`` and one flag a field of ``cls``."""
    parser.add_argument(
        "--config", metavar="FILE", help="TOML file with the same names as the flags (dashes as underscores)"
    )
    if any(f.metadata.get("research") for f in fields(cls)):
        parser.add_argument("--help-all", action=_HelpAll, nargs=0, help="show this and the options of experiments")
    add_flags(parser, cls)


class _HelpAll(argparse.Action):
    """Shows the help of every flag."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> NoReturn:
        """See :class:`argparse.Action`."""
        for action in parser._actions:
            action.help = getattr(action, "full_help", action.help)
        parser.print_help()
        parser.exit()


def add_flags(parser: argparse._ActionsContainer, cls: type[DataclassInstance]) -> None:
    """Add one flag a field of ``cls``, to a parser or to a group of its flags."""
    hints = typing.get_type_hints(cls)
    for f in fields(cls):
        if "help" not in f.metadata:
            continue
        kind, _ = _plain_type(hints[f.name])
        text = f.metadata["help"] + ("" if f.default in (None, MISSING, "") else f" (default: {f.default})")
        flag = "--" + f.name.replace("_", "-")
        text = text.replace("%", "%%")
        if kind is bool:
            action = parser.add_argument(flag, action=argparse.BooleanOptionalAction, default=None, help=text)
        else:
            action = parser.add_argument(
                flag, type=kind, choices=f.metadata["choices"], default=None, metavar=_metavar(f, kind), help=text
            )
        if f.metadata["research"]:
            action.full_help, action.help = action.help, argparse.SUPPRESS  # type: ignore[attr-defined]


def given_flags(arguments: argparse.Namespace, cls: type[DataclassInstance]) -> list[str]:
    """Names of the flags of ``cls`` (``--config`` too) that stand on the command line."""
    names = ("config", *(f.name for f in fields(cls) if "help" in f.metadata))
    return [name.replace("_", "-") for name in names if getattr(arguments, name, None) is not None]


SECTIONS = ("encoder", "server", "client")
"""Tables of a configuration file that several commands share."""


def load_settings(cls: type[S], arguments: argparse.Namespace, *beside: type[DataclassInstance]) -> S:
    """Build ``cls`` from parsed flags over the TOML file over the defaults. Raises :class:`ConfigError`.

    A file may serve several commands: of the tables named in :data:`SECTIONS` each reads its own (its settings' class
    variable ``SECTION``), over the keys outside of any. Keys of the classes ``beside`` are known, and left to them.
    """
    values: dict[str, Any] = {}
    names, others = _names(cls), set().union(*map(_names, beside))
    if getattr(arguments, "config", None):
        table = _read_toml(Path(arguments.config), names | others, getattr(cls, "SECTION", None))
        values.update((name, value) for name, value in table.items() if name in names)
    for name in names:
        given = getattr(arguments, name, None)
        if given is not None:
            values[name] = given
    return cls(**values)


def _names(cls: type[Any]) -> set[str]:
    return {f.name for f in fields(cls) if "help" in f.metadata}


def _read_toml(path: Path, names: set[str], section: str | None) -> dict[str, Any]:
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8-sig"))  # Windows puts a mark before it
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror}); give an existing TOML file") from error
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"{path}: is not TOML ({error})") from error
    parts = {name: table.pop(name) for name in SECTIONS if isinstance(table.get(name), dict)}
    table.update(parts.get(section or "", {}))
    unknown = sorted(set(table) - names)
    if unknown:
        raise ConfigError(f"{path}: unknown key {unknown[0]!r}; known: {', '.join(sorted(names))}")
    return table


def _plain_type(hint: Any) -> tuple[type, bool]:
    """The type inside ``X | None``, and whether None is allowed."""
    arms = (
        typing.get_args(hint)
        if isinstance(hint, types.UnionType) or typing.get_origin(hint) is typing.Union
        else (hint,)
    )
    plain = [arm for arm in arms if arm is not type(None)]
    return cast("type", plain[0]), len(plain) < len(arms)


def _metavar(f: Field[Any], kind: type) -> str | None:
    if f.metadata["choices"]:
        return None
    return {int: "N", float: "X", str: f.name.upper()}.get(kind, f.name.upper())


def _check_value(f: Field[Any], kind: type, value: Any) -> None:
    if kind is float and isinstance(value, int) and not isinstance(value, bool):
        value = float(value)
    if not isinstance(value, kind) or (kind is int and isinstance(value, bool)):
        raise ConfigError(f"{f.name} = {value!r} must be of type {kind.__name__}")
    if isinstance(value, float) and not math.isfinite(value):
        raise ConfigError(f"{f.name} = {value} must be finite")
    low, high = f.metadata.get("low"), f.metadata.get("high")
    if (low is not None and value < low) or (high is not None and value > high):
        raise ConfigError(
            f"{f.name} = {value} must lie in [{'-inf' if low is None else low}, {'inf' if high is None else high}]"
        )
    choices = f.metadata.get("choices")
    if choices and value not in choices:
        raise ConfigError(f"{f.name} = {value!r} must be one of {', '.join(choices)}")
