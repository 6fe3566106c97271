"""The flags that the project's commands have, by their own help."""

from __future__ import annotations

import contextlib
import io
import re
from functools import cache
from importlib import import_module

from cags_common.runtime.entry import COMMANDS as MODULES

FLAG = re.compile(r"(?<![\w/-])--[a-z][a-z0-9-]+")


@cache
def flags_of(command: str, part: str = "") -> frozenset[str]:
    found = told_by(command, part, "--help")
    assert found >= {"--help"}, f"{command} {part}"
    return found | told_by(command, part, "--help-all") if "--help-all" in found else found


def told_by(command: str, part: str, flag: str) -> frozenset[str]:
    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.suppress(SystemExit):
        import_module(MODULES[command]).main([*part.split(), flag])
    return frozenset(FLAG.findall(said.getvalue()))


@cache
def parts() -> dict[str, tuple[str, ...]]:
    from cags_bench.cli import SUBCOMMANDS as EXPERIMENTS
    from cags_research.training.cli import SUBCOMMANDS as TRAININGS

    return {"cags-bench": tuple(EXPERIMENTS), "cags-train": tuple(TRAININGS)}


@cache
def every_flag() -> frozenset[str]:
    plain = [flags_of(command) for command in MODULES]
    return frozenset().union(*plain, *(flags_of(c, part) for c, all_of in parts().items() for part in all_of))
