"""Settings: one frozen dataclass gives a command its flags, its TOML keys, its checks and its help.

    @dataclass(frozen=True)
    class ServerSettings:
        port: int = setting(8765, "TCP port to listen on; 0 picks a free one", low=0, high=65535)

Flags win over the file, the file over the defaults. Unknown keys are refused by name.
"""

from __future__ import annotations

import argparse
import difflib
import math
import re
import tomllib
import types
import typing
from collections.abc import Callable, Collection, Mapping
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
    words: Mapping[str, float] | None = None,
    research: bool = False,
) -> Any:
    """A dataclass field with a one-line description (unit included) and its range ``[low, high]`` or its choices.

    ``words`` are names of numbers (such as auto for 0), for a flag and in a file. One that only ``research`` changes
    is shown by ``--help-all`` and not by ``--help``.
    """
    metadata = {"help": help, "low": low, "high": high, "choices": choices, "words": words or {}, "research": research}
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
        default = next((word for word, number in f.metadata["words"].items() if number == f.default), f.default)
        text = f.metadata["help"] + ("" if default in (None, MISSING, "") else f" (default: {default})")
        flag = "--" + f.name.replace("_", "-")
        text = text.replace("%", "%%")
        if kind is bool:
            action = parser.add_argument(flag, action=argparse.BooleanOptionalAction, default=None, help=text)
        else:
            read = _reader(kind, f.metadata["words"])
            action = parser.add_argument(
                flag, type=read, choices=f.metadata["choices"], default=None, metavar=_metavar(f, kind), help=text
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
    names, others = _names(cls), set().union(*map(_names, beside))
    flags = {name: given for name in names if (given := getattr(arguments, name, None)) is not None}
    if not getattr(arguments, "config", None):
        return cls(**flags)
    file = _ConfigFile(Path(arguments.config), getattr(cls, "SECTION", None))
    file.check_keys(names | others, {name for name in vars(arguments) if name not in names | others})
    words = {f.name: f.metadata["words"] for f in fields(cls) if "help" in f.metadata}
    values = {name: _named_number(value, words[name]) for name, value in file.values.items() if name in names}
    try:
        return cls(**values | flags)
    except ConfigError as error:
        if _refusal(cls, flags) == str(error):  # the same without the file
            raise
        at_fault = [name for name in re.findall(r"\w+", str(error)) if name in values.keys() - flags.keys()]
        raise ConfigError(f"{file.place(*at_fault[:1])}: {error}") from error


def _names(cls: type[Any]) -> set[str]:
    return {f.name for f in fields(cls) if "help" in f.metadata}


def _refusal(cls: type[DataclassInstance], values: dict[str, Any]) -> str | None:
    """What ``cls`` says against ``values``; None if it takes them."""
    try:
        cls(**values)
    except ConfigError as error:
        return str(error)
    return None


def _named_number(value: Any, words: Mapping[str, float]) -> Any:
    return words.get(value, value) if isinstance(value, str) else value


class _ConfigFile:
    """A TOML file: the keys for a command with their values, and where they stand. Raises :class:`ConfigError`."""

    def __init__(self, path: Path, section: str | None) -> None:
        self._path = path
        try:
            self._text = path.read_text(encoding="utf-8-sig")  # Windows puts a mark before it
            table = tomllib.loads(self._text)
        except OSError as error:
            raise ConfigError(f"{path}: cannot be read ({error.strerror}); give an existing TOML file") from error
        except UnicodeDecodeError as error:
            raise ConfigError(f"{path}: is not TOML (byte {error.start} is not UTF-8); save it as UTF-8") from error
        except (ValueError, RecursionError) as error:
            raise ConfigError(f"{path}: is not TOML ({error}); lines are such as name = 1 or name = 'text'") from error
        parts = {name: table.pop(name) for name in SECTIONS if isinstance(table.get(name), dict)}
        own = parts.get(section or "", {})
        self.values: dict[str, Any] = {**table, **own}
        self._tables = {name: section if name in own else None for name in self.values}

    def check_keys(self, known: Collection[str], others: Collection[str]) -> None:
        """Refuse a key that is not ``known``. ``others`` are names of flags that no file can give."""
        unknown = sorted(set(self.values) - set(known))
        if not unknown:
            return
        name, place = unknown[0], self.place(unknown[0])
        if name in others:
            raise ConfigError(f"{place}: {name!r} can be given on the command line only; move it there")
        near = difflib.get_close_matches(name.replace("-", "_"), known, n=1)
        hint = f"did you mean {near[0]!r}? " if near else ""
        raise ConfigError(f"{place}: unknown key {name!r}; {hint}known: {', '.join(sorted(known))}")

    def place(self, name: str | None = None) -> str:
        """The file, with the line of key ``name`` if it can be found."""
        line = self._line(name) if name else None
        return str(self._path) if line is None else f"{self._path}, line {line}"

    def _line(self, name: str) -> int | None:
        table: str | None = None
        for number, text in enumerate(self._text.splitlines(), 1):
            if header := re.match(r"\s*\[+\s*[\"']?([^]\"']*?)[\"']?\s*\]", text):
                table = header[1]
                if table == name:
                    return number
            elif table == self._tables.get(name) and re.match(rf"\s*[\"']?{re.escape(name)}[\"']?\s*[=.]", text):
                return number
        return None


def _reader(kind: type, words: Mapping[str, float]) -> Callable[[str], Any]:
    """What makes a flag's text a value. Its name is that of ``kind``, for messages."""
    if not words:
        return kind

    def read(text: str) -> Any:
        return words[text] if text in words else kind(text)

    read.__name__ = " or ".join([kind.__name__, *words])
    return read


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
    given = value
    if kind is float and isinstance(value, int) and not isinstance(value, bool):
        value = float(value)
    words = f.metadata.get("words") or {}
    if not isinstance(value, kind) or (kind is int and isinstance(value, bool)):
        named = "".join(f" or {word!r}" for word in words)
        raise ConfigError(f"{f.name} = {value!r} must be {KINDS.get(kind, kind.__name__)}{named}")
    if isinstance(value, float) and not math.isfinite(value):
        raise ConfigError(f"{f.name} = {given} must be finite")
    low, high = f.metadata.get("low"), f.metadata.get("high")
    if (low is not None and value < low) or (high is not None and value > high):
        raise ConfigError(f"{f.name} = {given} must {range_text(low, high)}")
    choices = f.metadata.get("choices")
    if choices and value not in choices:
        raise ConfigError(f"{f.name} = {value!r} must be one of {', '.join(choices)}")


KINDS = {int: "a whole number", float: "a number", str: "text in quotes", bool: "true or false"}
"""What a configuration file must give for a type."""


def range_text(low: float | None, high: float | None) -> str:
    """What a value of the range must do: ``lie in [1, 5]``, ``be at least 1`` or ``be at most 5``."""
    if low is None:
        return f"be at most {high}"
    return f"be at least {low}" if high is None else f"lie in [{low}, {high}]"
