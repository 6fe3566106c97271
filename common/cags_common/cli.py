"""What every command shares: exit codes, one-line errors, quiet interrupts."""

from __future__ import annotations

import argparse
import io
import math
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import NoReturn

from cags_common.errors import REFUSALS, CagsError, ConfigError
from cags_common.runtime.endings import EXIT_SIGNAL, REQUESTS, heard, leave_at_next

EXIT_OK, EXIT_FAILED, EXIT_USAGE = 0, 1, 2
AGAIN_S = 0.01
"""When a signal that was lost is sent again, seconds: what lost it is over by then."""


class CommandParser(argparse.ArgumentParser):
    """Refuses wrong use in one line, not in a screenful of flags.

    So is an empty name, such as an unset variable of a shell gives: ``--record ""`` would record nothing.
    """

    def parse_known_args(  # type: ignore[override]
        self, args: Sequence[str] | None = None, namespace: argparse.Namespace | None = None
    ) -> tuple[argparse.Namespace, list[str]]:
        """See :meth:`argparse.ArgumentParser.parse_known_args`."""
        found, others = super().parse_known_args(args, namespace)
        for action in self._actions:  # those of settings have a type, and say themselves what may be empty
            if (
                action.option_strings
                and action.type is None
                and getattr(found, action.dest, None) == "" != action.default
            ):
                self.error(f"argument {'/'.join(action.option_strings)}: is empty; give a name, or leave it out")
        return found, others

    def error(self, message: str) -> NoReturn:
        """See :meth:`argparse.ArgumentParser.error`."""
        self.exit(EXIT_USAGE, f"{self.prog}: {message}; {self.prog} --help shows what there is\n")


def command_parser(prog: str, description: str, examples: str) -> argparse.ArgumentParser:
    """An argument parser that keeps the layout of ``examples``, refuses abbreviated flags and tells the version."""
    parser = CommandParser(
        prog=prog,
        description=description,
        epilog="examples:\n" + examples.rstrip(),
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("--version", action=_Version, nargs=0, help="print the version and exit")
    return parser


class _Version(argparse.Action):
    """Looks the version up only when asked: it is read from the installed distribution."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> NoReturn:
        """See :class:`argparse.Action`."""
        print(f"{parser.prog} {program_version()}")
        parser.exit()


def program_version() -> str:
    """Version of the installed distribution."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("cags-stream")
    except PackageNotFoundError:
        return "(not installed)"


def run_command(prog: str, body: Callable[[Sequence[str]], int | None], argv: Sequence[str] | None = None) -> int:
    """Run a command's body; turn :class:`CagsError` into one line on stderr and the exit code 1 (2 for wrong use).

    So is what the system refuses (a full disk, a folder that cannot be written). A request to end leaves as an
    interrupt does: children are stopped and files in the making removed. The next one ends the process at once
    (:mod:`cags_common.runtime.endings`).

    Without ``argv`` the process is the command's: once it has been asked to end, it does so as soon as everything is in
    order, without waiting for threads.
    """
    alone = argv is None
    try:
        with _ending_in_order(alone):
            code = _run(prog, body, sys.argv[1:] if argv is None else argv)
    except KeyboardInterrupt:
        code = _failed(prog, "interrupted", EXIT_SIGNAL + signal.SIGINT)
    except SystemExit as end:
        if not (alone and heard() and isinstance(end.code, int)):
            raise
        code = end.code
    return _end(code) if alone and heard() else code


def _run(prog: str, body: Callable[[Sequence[str]], int | None], argv: Sequence[str]) -> int:
    try:
        _open_closed_streams()
        _print_whatever_the_locale()
        code = body(argv) or EXIT_OK
        sys.stdout.flush()  # here, where a full disk is told of, and not while Python ends
        return code
    except ConfigError as error:
        return _failed(prog, error, EXIT_USAGE)
    except CagsError as error:
        return _failed(prog, error, EXIT_FAILED)
    except BrokenPipeError:  # the reader of our output (head, less) went away: not an error of ours
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_OK
    except OSError as error:
        if error.errno not in REFUSALS:
            raise
        where = error.filename or "output"
        return _failed(prog, f"{where}: {(error.strerror or str(error)).lower()}; {REFUSALS[error.errno]}", EXIT_FAILED)


def _end(code: int) -> NoReturn:
    """End the process without waiting for its threads, as Python would: none has anything to finish any more.

    Python would also give its signals their usual effect first, and another request would end it as a failure does.
    """
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):
            stream.flush()
    os._exit(code)


def _failed(prog: str, why: object, code: int) -> int:
    with suppress(OSError):  # nowhere to say it
        print(f"{prog}: {why}", file=sys.stderr)
    with suppress(OSError, ValueError):
        sys.stdout.flush()
        return code
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # what is left cannot be written at the end either
    return code


def _open_closed_streams() -> None:
    """Streams that were closed before the start (``>&-``, some daemons) lead nowhere.

    Python has None for them, and the next file or socket to be opened would take their number, and what is printed.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):  # in order: each takes the lowest free number
        if getattr(sys, name) is None:
            setattr(sys, name, Path(os.devnull).open(mode))  # noqa: SIM115  # for as long as the command runs


def _print_whatever_the_locale() -> None:
    """What a terminal's character set lacks is replaced: a table with a dash is no reason to fail.

    UTF-8 lacks nothing but the odd bytes that names of files may hold, and those go through as they are.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="surrogateescape" if stream.encoding.lower() == "utf-8" else "replace")


@contextmanager
def _ending_in_order(alone: bool) -> Iterator[None]:
    """SIGTERM and a terminal that is closed raise :class:`SystemExit`, where Python would end on the spot.

    An interrupt raises :class:`KeyboardInterrupt`. ``alone``: the process ends after the block, so it may be ended.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    usual = {number: handler for number in REQUESTS if (handler := signal.getsignal(number)) in AS_PYTHON_STARTS}
    asked = False

    def end(number: int, _: object) -> None:
        nonlocal asked
        asked = True
        leave_at_next()
        raise KeyboardInterrupt if number == signal.SIGINT else SystemExit(EXIT_SIGNAL + number)

    def listen() -> None:
        for number in usual:
            signal.signal(number, end)

    listen()
    try:
        with _no_signal_lost(listen):
            yield
    finally:
        if not alone:
            for number, handler in usual.items():
                signal.signal(number, handler)
        elif not asked:
            leave_at_next(-math.inf)


AS_PYTHON_STARTS = (signal.SIG_DFL, signal.default_int_handler)
"""Handlers that nobody has chosen."""


@contextmanager
def _no_signal_lost(listen: Callable[[], None]) -> Iterator[None]:
    """Send a signal again whose exception came up where Python drops it, as in the callback of a weak reference or in
    a finaliser. The command would go on as if nobody had asked it to end. ``listen`` makes it count as the first again.
    """
    usual = sys.unraisablehook

    def hook(unraisable: sys.UnraisableHookArgs) -> None:
        number = _signal_of(unraisable.exc_type, unraisable.exc_value)
        if number is None:
            usual(unraisable)
            return
        listen()
        threading.Timer(AGAIN_S, signal.pthread_kill, (threading.main_thread().ident, number)).start()

    sys.unraisablehook = hook
    try:
        yield
    finally:
        sys.unraisablehook = usual


def _signal_of(kind: type[BaseException], error: BaseException | None) -> int | None:
    """The signal whose handler raised ``error``; None for other errors."""
    if issubclass(kind, KeyboardInterrupt):
        return signal.SIGINT
    ends = {EXIT_SIGNAL + number: number for number in (signal.SIGTERM, signal.SIGHUP)}
    return ends.get(error.code) if isinstance(error, SystemExit) else None  # type: ignore[arg-type]
