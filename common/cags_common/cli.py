"""What every command shares: exit codes, one-line errors, quiet interrupts."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Sequence
from typing import NoReturn

from cags_common.errors import CagsError, ConfigError

EXIT_OK, EXIT_FAILED, EXIT_USAGE, EXIT_INTERRUPTED = 0, 1, 2, 130


class CommandParser(argparse.ArgumentParser):
    """Refuses wrong use in one line, not in a screenful of flags."""

    def error(self, message: str) -> NoReturn:
        """See :meth:`argparse.ArgumentParser.error`."""
        self.exit(EXIT_USAGE, f"{self.prog}: {message}; {self.prog} --help shows what there is\n")


def command_parser(prog: str, description: str, examples: str) -> argparse.ArgumentParser:
    """An argument parser that keeps the layout of ``examples`` and refuses abbreviated flags."""
    return CommandParser(
        prog=prog,
        description=description,
        epilog="examples:\n" + examples.rstrip(),
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )


def run_command(prog: str, body: Callable[[Sequence[str]], int | None], argv: Sequence[str] | None = None) -> int:
    """Run a command's body; turn :class:`CagsError` into one line on stderr and the exit code 1 (2 for wrong use)."""
    try:
        return body(sys.argv[1:] if argv is None else argv) or EXIT_OK
    except ConfigError as error:
        print(f"{prog}: {error}", file=sys.stderr)
        return EXIT_USAGE
    except CagsError as error:
        print(f"{prog}: {error}", file=sys.stderr)
        return EXIT_FAILED
    except KeyboardInterrupt:
        print(f"{prog}: interrupted", file=sys.stderr)
        return EXIT_INTERRUPTED
    except BrokenPipeError:  # the reader of our output (head, less) went away: not an error of ours
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_OK
